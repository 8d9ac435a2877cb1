/// The line of a wire and the place of its figures.
///
/// Invariant: the layout's way is drawn only while both its ends are where the layout put them.
import type { Box, Placed } from './layout';

/// Radius of a corner, px.
const ROUND = 7;
/// An end may be so far from where the layout put it, px: half a port.
const NEAR = 6;

/// The way that the layout found, between the ends as they are; none where one of them was moved.
export function laid(way: Placed[] | undefined, from: Placed, to: Placed): Placed[] | undefined {
  const isNear = (a: Placed, b: Placed) => Math.abs(a.x - b.x) <= NEAR && Math.abs(a.y - b.y) <= 1;
  if (!way || way.length < 2 || !isNear(way[0]!, from) || !isNear(way.at(-1)!, to)) return undefined;
  return way.length === 2 ? [from, to] : [from, ...way.slice(1, -1), to];
}

/// The path of SVG through these points, with round corners.
export function rounded(way: Placed[]): string {
  let path = `M${way[0]!.x},${way[0]!.y}`;
  for (let i = 1; i < way.length - 1; i += 1) {
    const [before, at, after] = [way[i - 1]!, way[i]!, way[i + 1]!];
    const r = Math.min(ROUND, length(before, at) / 2, length(at, after) / 2);
    const [a, b] = [towards(at, before, r), towards(at, after, r)];
    path += `L${a.x},${a.y}Q${at.x},${at.y} ${b.x},${b.y}`;
  }
  return `${path}L${way.at(-1)!.x},${way.at(-1)!.y}`;
}

function length(a: Placed, b: Placed): number {
  return Math.hypot(a.x - b.x, a.y - b.y);
}

function towards(from: Placed, to: Placed, by: number): Placed {
  const all = length(from, to) || 1;
  return { x: from.x + ((to.x - from.x) / all) * by, y: from.y + ((to.y - from.y) / all) * by };
}

/// A size that figures need, px.
export interface Size {
  width: number;
  height: number;
}

/// Figures in a line, in lines below each other, and no more than the rate and losses.
const PLAIN: Size[] = [{ width: 150, height: 15 }, { width: 74, height: 28 }, { width: 48, height: 15 }];
/// Width of a letter of them, and of "dropped" below a rate, px.
const LETTER = 6.6;
const DROPPED = 56;

/// The sizes that figures can have, the best first: with the number of losses, and at last with a word in its
/// place. A number of which a card hides a part would be another one. `letters`: how much larger than usual.
export function sizesOf(loss: string, letters: number): Size[] {
  const wide = loss.length * LETTER + 10;
  const lossy = [{ width: 140 + wide, height: 15 }, { width: Math.max(84, wide), height: 41 }, { width: wide, height: 28 }, { width: DROPPED, height: 28 }];
  return (loss ? lossy : PLAIN).map(({ width, height }) => ({ width: width * letters, height: height * letters }));
}

/// The first of these sizes that has a place on the way beside the cards, and the middle of that place.
/// The last size, at the place where it covers least, if none has one. `shared`: other wires leave the output.
export function spot(way: Placed[], cards: Box[], sizes: Size[], shared: boolean): Placed & { size: number } {
  const places = along(way, shared);
  let least = { ...places[0]!, size: sizes.length - 1, covers: Infinity };
  for (const [n, size] of sizes.entries()) {
    for (const at of places) {
      const covers = covered(at, size, cards);
      if (covers === 0) return { ...at, size: n };
      if (n === sizes.length - 1 && covers < least.covers) least = { ...at, size: n, covers };
    }
  }
  return least;
}

/// Places on a way: the middles of its parts, the longest first, and then others.
function along(way: Placed[], shared: boolean): Placed[] {
  const parts = way.slice(1).map((b, i) => ({ a: way[i]!, b, long: length(way[i]!, b) }));
  // The part that wires of one output have in common is the first.
  const own = shared && parts.length > 2 ? parts.slice(1) : parts;
  own.sort((p, q) => q.long - p.long);
  return [0.5, 0.3, 0.7, 0.15, 0.85].flatMap((t) => own.map(({ a, b }) => ({ x: a.x + (b.x - a.x) * t, y: a.y + (b.y - a.y) * t })));
}

/// The part of the cards that figures at this place would cover, px².
function covered(at: Placed, size: Size, cards: Box[]): number {
  const [left, right, top, bottom] = [at.x - size.width / 2, at.x + size.width / 2, at.y - size.height / 2, at.y + size.height / 2];
  let sum = 0;
  for (const c of cards) {
    const w = Math.min(right, c.x + c.width) - Math.max(left, c.x);
    const h = Math.min(bottom, c.y + c.height) - Math.max(top, c.y);
    if (w > 0 && h > 0) sum += w * h;
  }
  return sum;
}

/// The line of a wire.
///
/// Invariant: the layout's way is drawn only while both its ends are where the layout put them.
import type { Placed } from './layout';

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

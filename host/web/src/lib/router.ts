/// A way around the cards for a wire that the layout does not know: it was made since, or its card was moved.
///
/// Invariant: a way crosses no card between its ends; there may be none, and the wire is a plain curve then.
import type { Box, Placed } from './layout';

/// Between a wire and a card, px.
const CLEAR = 12;
/// A wire leaves and enters straight for this long, px.
const STRAIGHT = 16;
/// A bend costs as much as this way, px.
const BEND = 70;
/// Cards further away than this from both ends are not asked, px.
const REACH = 320;
/// With more cards than this around it a wire is a plain curve.
const MOST = 48;

/// From the right side of one card to the left side of another, with level ends.
export function routed(from: Placed, to: Placed, cards: Box[]): Placed[] | undefined {
  const [start, goal] = [{ x: from.x + STRAIGHT, y: from.y }, { x: to.x - STRAIGHT, y: to.y }];
  const area = { left: Math.min(start.x, goal.x) - REACH, right: Math.max(start.x, goal.x) + REACH, top: Math.min(from.y, to.y) - REACH, bottom: Math.max(from.y, to.y) + REACH };
  const near = cards.filter((c) => c.x < area.right && c.x + c.width > area.left && c.y < area.bottom && c.y + c.height > area.top);
  if (near.length > MOST) return undefined;
  const lines = (at: (c: Box) => number[], ends: number[]) => [...new Set([...near.flatMap(at), ...ends])].sort((a, b) => a - b);
  const xs = lines((c) => [c.x - CLEAR, c.x + c.width + CLEAR], [start.x, goal.x]);
  const ys = lines((c) => [c.y - CLEAR, c.y + c.height + CLEAR], [start.y, goal.y]);
  const found = search(new Grid(xs, ys, near), [xs.indexOf(start.x), ys.indexOf(start.y)], [xs.indexOf(goal.x), ys.indexOf(goal.y)]);
  return found && straightened([from, ...found, to]);
}

/// Crossings of the lines on which wires may go.
class Grid {
  constructor(
    public xs: number[],
    public ys: number[],
    private cards: Box[],
  ) {}

  /// Whether the line between two neighbours is free of cards.
  isFree(ax: number, ay: number, bx: number, by: number): boolean {
    const [left, right] = [Math.min(this.xs[ax]!, this.xs[bx]!), Math.max(this.xs[ax]!, this.xs[bx]!)];
    const [top, bottom] = [Math.min(this.ys[ay]!, this.ys[by]!), Math.max(this.ys[ay]!, this.ys[by]!)];
    const slack = CLEAR - 2;
    return !this.cards.some((c) => right > c.x - slack && left < c.x + c.width + slack && bottom > c.y - slack && top < c.y + c.height + slack);
  }
}

const STEPS = [[1, 0], [0, 1], [-1, 0], [0, -1]] as const;

/// The cheapest way by length and bends (Dijkstra), from going right at its start to going right at its goal.
function search(grid: Grid, start: [number, number], goal: [number, number]): Placed[] | undefined {
  const [wide, high] = [grid.xs.length, grid.ys.length];
  const key = (x: number, y: number, d: number) => (y * wide + x) * 4 + d;
  const cost = new Float64Array(wide * high * 4).fill(Infinity);
  const before = new Int32Array(wide * high * 4).fill(-1);
  const open = new Heap();
  const first = key(...start, 0);
  cost[first] = 0;
  open.push(0, first);
  const isGoal = (at: number) => at >> 2 === goal[1] * wide + goal[0];
  let last = open.pop();
  for (let at = last; at !== undefined && !isGoal(at); last = at = open.pop()) {
    const d = at % 4;
    const [x, y] = [Math.floor(at / 4) % wide, Math.floor(at / 4 / wide)];
    for (const [turn, [dx, dy]] of STEPS.entries()) {
      const [nx, ny] = [x + dx, y + dy];
      if (Math.abs(turn - d) === 2 || nx < 0 || ny < 0 || nx >= wide || ny >= high || !grid.isFree(x, y, nx, ny)) continue;
      const length = Math.abs(grid.xs[nx]! - grid.xs[x]!) + Math.abs(grid.ys[ny]! - grid.ys[y]!);
      const next = key(nx, ny, turn);
      // It leaves the goal to the right: it cannot come back from there.
      if (isGoal(next) && turn === 2) continue;
      const sum = cost[at]! + length + (turn === d ? 0 : BEND) + (isGoal(next) && turn !== 0 ? BEND : 0);
      if (sum >= cost[next]!) continue;
      cost[next] = sum;
      before[next] = at;
      open.push(sum, next);
    }
  }
  if (last === undefined) return undefined;
  const way: Placed[] = [];
  for (let at: number = last; at >= 0; at = before[at]!) way.unshift({ x: grid.xs[Math.floor(at / 4) % wide]!, y: grid.ys[Math.floor(at / 4 / wide)]! });
  return way;
}

/// Without the points at which it goes straight on.
function straightened(way: Placed[]): Placed[] {
  return way.filter((p, i) => {
    const [a, b] = [way[i - 1], way[i + 1]];
    return !a || !b || !((a.x === p.x && p.x === b.x) || (a.y === p.y && p.y === b.y));
  });
}

/// The smallest first; what was found cheaper since is skipped by its cost.
class Heap {
  #items: { by: number; what: number }[] = [];

  push(by: number, what: number) {
    const all = this.#items;
    let i = all.push({ by, what }) - 1;
    for (let up = (i - 1) >> 1; i > 0 && all[up]!.by > by; i = up, up = (i - 1) >> 1) [all[i], all[up]] = [all[up]!, all[i]!];
  }

  pop(): number | undefined {
    const all = this.#items;
    const top = all[0];
    const end = all.pop();
    if (!top || !end || all.length === 0) return top?.what;
    all[0] = end;
    for (let i = 0; ; ) {
      const [l, r] = [2 * i + 1, 2 * i + 2];
      let least = i;
      if (l < all.length && all[l]!.by < all[least]!.by) least = l;
      if (r < all.length && all[r]!.by < all[least]!.by) least = r;
      if (least === i) return top.what;
      [all[i], all[least]] = [all[least]!, all[i]!];
      i = least;
    }
  }
}

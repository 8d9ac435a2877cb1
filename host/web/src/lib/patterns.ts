/// Patterns over process/component/output, as `trocar record` reads them.
///
/// Invariant: a pattern means here what it means there (host/cli/src/recording/select.rs): `*` stands for any
/// part of one name, `**` for any number of names, and the name of a process or component for all in it.

/// A pattern with more names than this means nothing.
const LONGEST = 64;

export function matches(pattern: string, path: string): boolean {
  const names = parts(pattern);
  if (names.length === 0 || names.length > LONGEST) return false;
  return wild([...names, '**'], parts(path), (part) => part === '**', isName);
}

/// Whether a pattern may mean outputs of a component whose outputs are not known.
export function mayMean(pattern: string, component: string): boolean {
  return matches(pattern, component) || matches(parts(pattern).slice(0, -1).join('/'), component);
}

/// The patterns in a text: names hold neither spaces nor commas.
export function patternsIn(text: string): string[] {
  return [...new Set(text.split(/[\s,;]+/).filter(Boolean))];
}

function parts(path: string): string[] {
  return path.split('/').filter(Boolean);
}

/// Each item is compared without recursion: a hostile pattern costs its length times that of the items.
function wild(pattern: string[], items: string[], any: (part: string) => boolean, same: (part: string, item: string) => boolean): boolean {
  let [p, n] = [0, 0];
  let last: [number, number] | null = null;
  while (n < items.length) {
    const part = pattern[p];
    if (part !== undefined && any(part)) last = [p++, n];
    else if (part !== undefined && same(part, items[n]!)) [p, n] = [p + 1, n + 1];
    else if (last) {
      last = [last[0], last[1] + 1];
      [p, n] = [last[0] + 1, last[1]];
    } else return false;
  }
  return pattern.slice(p).every(any);
}

function isName(pattern: string, name: string): boolean {
  return wild([...pattern], [...name], (c) => c === '*', (p, c) => p === c || p === '?');
}

/// The names nearest to a pattern, the nearest first: a slip of the fingers, then names that begin alike.
export function nearestTo(pattern: string, names: string[], most = 5): string[] {
  const wanted = pattern.toLowerCase();
  const far = new Map(names.map((name) => [name, distance(wanted, name.toLowerCase())]));
  const isSlip = (name: string) => far.get(name)! <= Math.max(1, Math.floor(Math.max(pattern.length, name.length) / 3));
  const alike = (name: string) => {
    const mine = parts(pattern);
    const differs = parts(name).findIndex((part, i) => part !== mine[i]);
    return differs < 0 ? mine.length : differs;
  };
  const rank = (name: string) => (isSlip(name) ? far.get(name)! : 1e6 - alike(name) * 1e4 + far.get(name)!);
  return [...names].sort((a, b) => rank(a) - rank(b)).slice(0, most);
}

/// Letters to add, leave out, change or swap with their neighbour.
function distance(a: string, b: string): number {
  let before: number[] = [];
  let row = Array.from({ length: b.length + 1 }, (_, j) => j);
  for (let i = 1; i <= a.length; i += 1) {
    const next = [i];
    for (let j = 1; j <= b.length; j += 1) {
      const cost = a[i - 1] === b[j - 1] ? 0 : 1;
      let least = Math.min(row[j]! + 1, next[j - 1]! + 1, row[j - 1]! + cost);
      if (i > 1 && j > 1 && a[i - 1] === b[j - 2] && a[i - 2] === b[j - 1]) least = Math.min(least, before[j - 2]! + 1);
      next.push(least);
    }
    [before, row] = [row, next];
  }
  return row[b.length]!;
}

/// Curves: numbers over time out of outputs, events, state rows and read commands, in rings of fixed size.
///
/// Invariant: memory does not grow with time; all but reads come by the page's one Subscribe, state rows as
/// their tap's values. Reads are asked for one after the other, so a slow server slows their curves and
/// nothing else, and not while nobody sees the page.
import { interact, plain, said } from './api';
import { live } from './live.svelte';
import { pick, type Names } from './ports.svelte';
import { isGroup } from './schema';
import { Track } from './track';

/// Outputs and state rows are followed at these rates, Hz: a row has all numbers of a component.
const RATE = { output: 60, state: 25, event: 0, read: 0 };
/// Time between two reads, ms.
const ROUND = 40;

export type Source = 'output' | 'event' | 'state' | 'read';

export interface Signal {
  /// The address that is followed: process/component[/port[/member]].
  path: string;
  /// The number in it: "position[0]"; empty = the value itself.
  field: string;
  source: Source;
  unit: string;
  /// Names of an enum, which is drawn as its numbers.
  names?: Names;
}

/// The address asked for to have it.
export function followed(s: Signal): string {
  return s.source === 'state' ? `${s.path}/tap_rows` : s.path;
}

export function nameOf(s: Signal): string {
  return s.field ? `${s.path} · ${s.field}` : s.path;
}

/// The name an enum's number has; empty = none, or no enum.
export function named(s: Signal, n: number): string {
  return Object.entries(s.names ?? {}).find(([, number]) => number === n)?.[0] ?? '';
}

/// Signals of one unit share an axis; those with equal names count as one.
export function unitKey(s: Signal): string {
  return s.names ? `enum ${JSON.stringify(s.names)}` : s.unit === '1' ? '' : s.unit;
}

export function sameSignal(a: Signal, b: Signal): boolean {
  // A command and an event may have one name.
  return a.path === b.path && a.field === b.field && a.source === b.source;
}

/// A signal out of what was dropped on the page; undefined: it is none.
export function signalFrom(text: string): Signal | undefined {
  let s: Partial<Signal> | null;
  try {
    s = JSON.parse(text) as Partial<Signal> | null;
  } catch {
    return undefined;
  }
  const isText = (v: unknown) => typeof v === 'string';
  const isNames = (v: unknown) => v === undefined || (isGroup(v) && Object.values(v).every((n) => typeof n === 'number'));
  if (!isGroup(s) || ![s.path, s.field, s.unit].every(isText) || !isNames(s.names) || !Object.hasOwn(RATE, s.source ?? '')) return undefined;
  const { path, field, source, unit, names } = s as Signal;
  return /^[^/]+\/[^/]+/.test(path) ? { path, field, source, unit, names } : undefined;
}

let made = 0;

export class Curve {
  id = (made += 1);
  track = new Track();
  /// As it was when the plots were paused.
  frozen = $state.raw<Track | null>(null);
  skipped = 0;
  /// Times nothing came for a while.
  gaps = 0;
  /// Counts what came.
  changes = 0;
  why = $state('');
  #leave: () => void;

  constructor(public signal: Signal) {
    this.#leave =
      signal.source === 'read'
        ? reader.follow(this)
        : live.follow({
            path: followed(signal),
            rate: RATE[signal.source],
            width: 0,
            take: (item) => {
              this.skipped += Number(item.skipped);
              this.add(Number(item.stampNs) / 1e9, pick(plain(item.json), signal.field, signal.names));
            },
            lost: () => this.gap(),
          });
  }

  /// The points that are seen: of a pause, the copy.
  get seen(): Track {
    return this.frozen ?? this.track;
  }

  /// `at`: s of the host's monotonic clock.
  add(at: number, value: number) {
    if (this.track.add(at, value)) this.changes += 1;
  }

  /// Nothing came or could be read: no line leads over it.
  gap() {
    if (!this.track.gap()) return;
    this.gaps += 1;
    this.changes += 1;
  }

  close() {
    this.#leave();
  }
}

/// Asks for reads, round by round; one question serves all curves of a path.
class Reader {
  #curves = new Set<Curve>();
  #busy = false;

  follow(curve: Curve): () => void {
    this.#curves.add(curve);
    void this.#work();
    return () => this.#curves.delete(curve);
  }

  async #work() {
    if (this.#busy) return;
    this.#busy = true;
    while (this.#curves.size > 0) {
      const began = performance.now();
      const paths = new Map<string, Curve[]>();
      for (const c of this.#curves) paths.set(c.signal.path, [...(paths.get(c.signal.path) ?? []), c]);
      for (const [path, curves] of paths) {
        if (document.hidden) {
          for (const c of curves) c.gap();
          continue;
        }
        try {
          const answer = await interact.invoke({ path }, { timeoutMs: 2000 });
          const value = plain(answer.json);
          for (const c of curves) {
            c.why = '';
            c.add(Number(answer.stampNs) / 1e9, pick(value, c.signal.field, c.signal.names));
          }
        } catch (error) {
          for (const c of curves) {
            c.why = said(error);
            c.gap();
          }
        }
      }
      await new Promise((wake) => setTimeout(wake, Math.max(5, ROUND - (performance.now() - began))));
    }
    this.#busy = false;
  }
}

const reader = new Reader();

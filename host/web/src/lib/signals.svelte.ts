/// Curves: numbers over time out of outputs, events, state rows and read commands, in rings of fixed size.
///
/// Invariant: memory does not grow with time; all but reads come by the page's one Subscribe, state rows as what their tap gives.
/// Reads are asked for one after the other, so a slow server slows their curves and nothing else, and not while nobody sees the page.
import { interact, plain, said } from './api';
import { live } from './live.svelte';
import { pick, type Names } from './ports.svelte';

/// Points of a curve.
const KEPT = 3000;
/// Outputs and state rows are followed at these rates, Hz: a row has all numbers of a component.
const RATE = { output: 60, state: 25, event: 0 };
/// Time between two reads, ms.
const ROUND = 40;

export type Source = 'output' | 'event' | 'state' | 'read';

export interface Signal {
  /// What is followed: process/component[/port[/member]].
  path: string;
  /// The number in it: "position[0]"; empty = the value itself.
  field: string;
  source: Source;
  unit: string;
  /// Of an enum, which is drawn as its numbers.
  names?: Names;
}

/// What is asked for to have it.
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

export class Curve {
  x = new Float64Array(KEPT);
  y = new Float64Array(KEPT);
  n = 0;
  first = 0;
  skipped = 0;
  /// Times nothing came for a while.
  gaps = 0;
  why = $state('');
  latest = $state(Number.NaN);
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

  /// `at`: s of the host's monotonic clock.
  add(at: number, value: number) {
    if (this.n > 0) {
      const last = this.x[(this.first + this.n - 1) % KEPT]!;
      if (at === last) return;
      // Another run of the machine's clock, or of the component: the curve begins anew.
      if (at < last) this.n = this.first = 0;
    }
    const i = (this.first + this.n) % KEPT;
    this.x[i] = at;
    this.y[i] = value;
    if (this.n < KEPT) this.n += 1;
    else this.first = (this.first + 1) % KEPT;
  }

  /// Nothing came or could be read: no line leads over it.
  gap() {
    const last = (this.first + this.n - 1) % KEPT;
    if (this.n === 0 || !Number.isFinite(this.y[last]!)) return;
    this.add(this.x[last]! + 1e-6, Number.NaN);
    this.gaps += 1;
  }

  /// The last `seconds`, oldest first.
  window(seconds: number): [number[], number[]] {
    const xs: number[] = [];
    const ys: number[] = [];
    if (this.n === 0) return [xs, ys];
    const end = this.x[(this.first + this.n - 1) % KEPT]!;
    for (let k = 0; k < this.n; k += 1) {
      const i = (this.first + k) % KEPT;
      if (this.x[i]! >= end - seconds) {
        xs.push(this.x[i]! - end);
        ys.push(this.y[i]!);
      }
    }
    this.latest = ys[ys.length - 1] ?? Number.NaN;
    return [xs, ys];
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

/// Rates, latencies and losses: one List for everything, once a second, and what is different from the one before.
///
/// Invariant: one question at a time, so a slow server is asked more seldom, never more often.
import { SvelteMap } from 'svelte/reactivity';
import type { Connection } from '../gen/trocar/v1/types_pb';
import { gcm } from './api';
import { isPaced } from './execution';
import { offers } from './ports.svelte';
import { system } from './system.svelte';
import { componentOf } from './words';

const EVERY = 1000;
/// Answers a rate is taken over: one that was long on its way shifts it less.
const OVER = 4;
/// A source gives at each step where it gave this share of its steps something: it may have skipped the rest.
const EACH = 0.8;

export interface EdgeFigures {
  /// Samples, commands and events per second; bytes per second.
  rate: number;
  bytes: number;
  p50: number;
  p99: number;
  /// Since the connection was made, and per second now.
  dropped: number;
  /// A newer one took their place where only the newest is taken: no loss.
  skipped: number;
  dropping: number;
  failed: number;
  /// It carried something before, and nothing now.
  resting: boolean;
  /// Nor is that as it should be: its source gives at each step of a known period, or what it gives is not
  /// taken.
  stalled: boolean;
}

/// A connection as List told it, and the steps that its source had executed then.
interface Look {
  at: number;
  c: Connection;
  steps: bigint | undefined;
}

class Figures {
  edges = new SvelteMap<string, EdgeFigures>();
  /// As List told them last: Watch tells no carrier, depth or wake-up.
  listed = new SvelteMap<string, Connection>();
  steps = new SvelteMap<string, number>();
  warnings = $state<string[]>([]);
  /// The last answers, oldest first.
  #before = new Map<string, Look[]>();
  #executed = new Map<string, { at: number; n: bigint }[]>();
  #quiet = new Map<string, number>();
  /// Connections whose source gave at each of its steps, of a known period, while they carried something.
  #steady = new Set<string>();
  #stop: AbortController | null = null;

  async follow() {
    if (this.#stop) return;
    const stop = (this.#stop = new AbortController());
    while (!stop.signal.aborted) {
      try {
        const asked = performance.now();
        const list = await gcm.list({}, { signal: stop.signal, timeoutMs: 4000 });
        const at = (asked + performance.now()) / 2;
        this.#take(list.connections, at, new Map(list.components.map((c) => [c.path, c.stats?.executed])));
        this.warnings = list.warnings;
        for (const c of list.components) {
          const shown = system.components.get(c.path);
          if (!shown) continue;
          const n = c.stats?.executed;
          if (n !== undefined) {
            let past = this.#executed.get(c.path) ?? [];
            // Made anew: it counts from the beginning.
            if (past.length && n < past.at(-1)!.n) past = [];
            if (past.length) this.steps.set(c.path, Number(n - past[0]!.n) / ((at - past[0]!.at) / 1000));
            this.#executed.set(c.path, [...past, { at, n }].slice(-OVER));
          }
          // Watch alone says how it stands: its news may be newer than this answer.
          system.components.set(c.path, { ...shown, stats: c.stats });
        }
      } catch {
        // Watch says that the server is away; figures just stand still.
      }
      await new Promise((wake) => setTimeout(wake, EVERY));
    }
  }

  pause() {
    this.#stop?.abort();
    this.#stop = null;
  }

  #take(connections: Connection[], at: number, steps: Map<string, bigint | undefined>) {
    const seen = new Set<string>();
    for (const c of connections) {
      const id = String(c.id);
      seen.add(id);
      this.listed.set(id, c);
      let past = this.#before.get(id) ?? [];
      if (past.length && c.passed < past.at(-1)!.c.passed) past = [];
      const now: Look = { at, c, steps: steps.get(componentOf(c.server)) };
      this.#before.set(id, [...past, now].slice(-OVER));
      const old = past[0];
      if (!old) continue;
      const seconds = (at - old.at) / 1000;
      const moving = c.passed > past.at(-1)!.c.passed;
      const rate = moving ? Number(c.passed - old.c.passed) / seconds : 0;
      if (moving) this.#learn(id, old, now);
      const was = this.edges.get(id);
      const quiet = rate === 0 && was && (was.rate > 0.7 || this.#quiet.has(id)) ? (this.#quiet.get(id) ?? 0) + 1 : 0;
      if (quiet) this.#quiet.set(id, quiet);
      else this.#quiet.delete(id);
      const notTaken = c.dropped + c.skipped > past.at(-1)!.c.dropped + past.at(-1)!.c.skipped;
      const stalled = quiet >= 2 && (this.#steady.has(id) || notTaken);
      this.edges.set(id, {
        rate,
        bytes: Number(c.bytes - old.c.bytes) / seconds,
        p50: Number(c.latencyP50Ns),
        p99: Number(c.latencyP99Ns),
        dropped: Number(c.dropped),
        skipped: Number(c.skipped),
        dropping: Number(c.dropped - old.c.dropped) / seconds,
        failed: Number(c.failed),
        resting: quiet >= 2 && !stalled,
        stalled,
      });
    }
    for (const all of [this.edges, this.listed, this.#before, this.#quiet]) for (const id of [...all.keys()]) if (!seen.has(id)) all.delete(id);
    for (const id of [...this.#steady]) if (!seen.has(id)) this.#steady.delete(id);
  }

  /// Whether a period of this connection is known: its source has one, and gives something at each step.
  #learn(id: string, old: Look, now: Look) {
    if (old.steps === undefined || now.steps === undefined || now.steps <= old.steps) return;
    const given = (c: Connection) => Number(c.passed + c.dropped + c.skipped);
    const isEach = given(now.c) - given(old.c) >= EACH * Number(now.steps - old.steps);
    if (isEach && offers.port(now.c.server)?.kind === 'output' && isPaced(componentOf(now.c.server))) this.#steady.add(id);
    else this.#steady.delete(id);
  }
}

export const figures = new Figures();

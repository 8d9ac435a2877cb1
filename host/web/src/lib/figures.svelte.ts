/// Rates, latencies and losses: one List for everything, once a second, and what is different from the one before.
///
/// Invariant: one question at a time, so a slow server is asked more seldom, never more often.
import { SvelteMap } from 'svelte/reactivity';
import type { Connection } from '../gen/trocar/v1/types_pb';
import { gcm } from './api';
import { system } from './system.svelte';

const EVERY = 1000;
/// Answers a rate is taken over: one that was long on its way shifts it less.
const OVER = 4;

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
  /// It carried something before, and now nothing does.
  stalled: boolean;
}

class Figures {
  edges = new SvelteMap<string, EdgeFigures>();
  steps = new SvelteMap<string, number>();
  warnings = $state<string[]>([]);
  /// The last answers, oldest first.
  #before = new Map<string, { at: number; c: Connection }[]>();
  #executed = new Map<string, { at: number; n: bigint }[]>();
  #quiet = new Map<string, number>();
  #stop: AbortController | null = null;

  async follow() {
    if (this.#stop) return;
    const stop = (this.#stop = new AbortController());
    while (!stop.signal.aborted) {
      try {
        const asked = performance.now();
        const list = await gcm.list({}, { signal: stop.signal, timeoutMs: 4000 });
        const at = (asked + performance.now()) / 2;
        this.#take(list.connections, at);
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

  #take(connections: Connection[], at: number) {
    const seen = new Set<string>();
    for (const c of connections) {
      const id = String(c.id);
      seen.add(id);
      let past = this.#before.get(id) ?? [];
      if (past.length && c.passed < past.at(-1)!.c.passed) past = [];
      this.#before.set(id, [...past, { at, c }].slice(-OVER));
      const old = past[0];
      if (!old) continue;
      const seconds = (at - old.at) / 1000;
      const moving = c.passed > past.at(-1)!.c.passed;
      const rate = moving ? Number(c.passed - old.c.passed) / seconds : 0;
      const was = this.edges.get(id);
      const quiet = rate === 0 && was && (was.rate > 0.7 || was.stalled || this.#quiet.has(id)) ? (this.#quiet.get(id) ?? 0) + 1 : 0;
      if (quiet) this.#quiet.set(id, quiet);
      else this.#quiet.delete(id);
      this.edges.set(id, {
        rate,
        bytes: Number(c.bytes - old.c.bytes) / seconds,
        p50: Number(c.latencyP50Ns),
        p99: Number(c.latencyP99Ns),
        dropped: Number(c.dropped),
        skipped: Number(c.skipped),
        dropping: Number(c.dropped - old.c.dropped) / seconds,
        failed: Number(c.failed),
        stalled: quiet >= 2,
      });
    }
    for (const id of [...this.edges.keys()]) if (!seen.has(id)) this.edges.delete(id);
    for (const id of [...this.#before.keys()]) if (!seen.has(id)) this.#before.delete(id);
  }
}

export const figures = new Figures();

/// Events the page follows: the newest wait in a ring, wherever the page looks; only those that are drawn are taken apart.
///
/// Invariant: however many come, the ring stays as short; what gave way before it was drawn is part of the total.
import { plain } from './api';
import { live } from './live.svelte';
import type { SubscribeResponse } from '../gen/trocar/v1/interact_pb';

/// Rows kept.
export const KEPT = 200;

export interface Row {
  id: number;
  at: string;
  path: string;
  text: string;
  level: string;
}

class Followed {
  paths = $state.raw<string[]>([]);
  rows = $state.raw<Row[]>([]);
  /// Of all that came.
  total = $state(0);
  /// Items the server left out.
  skipped = $state(0);
  #ring = new Array<SubscribeResponse>(KEPT);
  #came = 0;
  #lost = 0;
  #leaves = new Map<string, () => void>();

  follow(path: string) {
    if (this.#leaves.has(path)) return;
    this.#leaves.set(path, live.follow({ path, rate: 0, width: 0, take: (item) => this.#take(item) }));
    this.paths = [...this.paths, path];
  }

  leave(path: string) {
    this.#leaves.get(path)?.();
    this.#leaves.delete(path);
    this.paths = this.paths.filter((p) => p !== path);
  }

  #take(item: SubscribeResponse) {
    this.#ring[this.#came % KEPT] = item;
    this.#came += 1;
    this.#lost += Number(item.skipped);
  }

  /// Puts what came since the last time into the rows.
  draw() {
    const drawn = this.total;
    if (this.#came === drawn) return;
    const fresh: Row[] = [];
    for (let k = Math.max(drawn, this.#came - KEPT); k < this.#came; k += 1) fresh.push(row(k, this.#ring[k % KEPT]!));
    this.rows = [...this.rows, ...fresh].slice(-KEPT);
    this.total = this.#came;
    this.skipped = this.#lost;
  }
}

function row(id: number, { path, json, stampNs, skipped }: SubscribeResponse): Row {
  const value = plain(json);
  return {
    id,
    at: `${(Number(stampNs) / 1e9).toFixed(4)} s`,
    path,
    text: `${value === null ? '' : JSON.stringify(value)}${skipped ? ` (${skipped} skipped before)` : ''}`,
    level: skipped ? 'warn' : '',
  };
}

export const events = new Followed();

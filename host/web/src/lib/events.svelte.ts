/// Events the page follows: the newest wait in a ring, wherever the page looks; only those that are drawn are taken apart.
///
/// Invariant: however many come, the ring stays as short; what gave way before it was drawn is part of the total. What came while
/// nobody listened is not known: how often that may be so is counted, and said where it was.
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

interface Came {
  item: SubscribeResponse;
  /// Nobody listened before it.
  cut: boolean;
}

class Followed {
  paths = $state.raw<string[]>([]);
  rows = $state.raw<Row[]>([]);
  /// Of all that came.
  total = $state(0);
  /// Items the server left out.
  skipped = $state(0);
  /// How often nobody listened for a while: to a page that was hidden, or whose server was away.
  interrupted = $state(0);
  #ring = new Array<Came>(KEPT);
  #came = 0;
  #lost = 0;
  #cuts = 0;
  /// Paths of which something may be missing before what comes next.
  #cut = new Set<string>();
  #leaves = new Map<string, () => void>();

  follow(path: string) {
    if (this.#leaves.has(path)) return;
    this.#leaves.set(path, live.follow({ path, rate: 0, width: 0, take: (item) => this.#take(item), lost: () => this.#cut.add(path) }));
    this.paths = [...this.paths, path];
  }

  leave(path: string) {
    this.#leaves.get(path)?.();
    this.#leaves.delete(path);
    this.#cut.delete(path);
    this.paths = this.paths.filter((p) => p !== path);
  }

  #take(item: SubscribeResponse) {
    const cut = this.#cut.delete(item.path);
    this.#ring[this.#came % KEPT] = { item, cut };
    this.#came += 1;
    this.#cuts += Number(cut);
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
    this.interrupted = this.#cuts;
  }
}

function row(id: number, { item, cut }: Came): Row {
  const { path, json, stampNs, skipped } = item;
  const value = plain(json);
  const missing = (skipped ? ` (${skipped} skipped before)` : '') + (cut ? ' (some before may be missing: nobody listened)' : '');
  return {
    id,
    at: `${(Number(stampNs) / 1e9).toFixed(4)} s`,
    path,
    text: `${value === null ? '' : JSON.stringify(value)}${missing}`,
    // Skipped is grey everywhere; that nobody listened is a warning.
    level: cut ? 'warn' : skipped ? 'skipped' : '',
  };
}

export const events = new Followed();

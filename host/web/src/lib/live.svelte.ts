/// Everything this page follows, in one Subscribe: events, outputs, thumbnails.
///
/// Invariant: a changed wish opens the new call before it leaves the old one, so that no view stands still; one path that is
/// refused never takes the others along.
import { SvelteMap } from 'svelte/reactivity';
import type { SubscribeResponse } from '../gen/trocar/v1/interact_pb';
import { interact, isGone, said, wasAborted } from './api';
import { componentOf } from './words';

/// Changed wishes are gathered this long, ms.
const GATHER = 60;
/// Pause before the next try, ms.
const AGAIN = 1000;

export interface Wish {
  path: string;
  /// Hz; 0 = what the server thinks right.
  rate: number;
  /// Pixels; 0 = no picture.
  width: number;
  take: (item: SubscribeResponse) => void;
}

class Live {
  /// Why a path cannot be followed.
  refused = new SvelteMap<string, string>();
  /// Items the server left out for this page, by path.
  skipped = new SvelteMap<string, number>();
  #wishes = new Set<Wish>();
  #now: AbortController | null = null;
  #gathering: ReturnType<typeof setTimeout> | undefined;
  #away = false;
  #running = 0;

  /// Follows until the returned function is called.
  follow(wish: Wish): () => void {
    this.#wishes.add(wish);
    this.#changed();
    return () => {
      this.#wishes.delete(wish);
      this.#changed();
    };
  }

  /// A component began anew: what was followed of it has ended.
  renewed(path: string) {
    for (const wish of this.#wishes) {
      if (componentOf(wish.path) === path) {
        this.#changed(GATHER * 4);
        return;
      }
    }
  }

  pause() {
    this.#away = true;
    this.#now?.abort();
    this.#now = null;
  }

  resume() {
    if (!this.#away) return;
    this.#away = false;
    this.#changed();
  }

  #changed(after = GATHER) {
    clearTimeout(this.#gathering);
    this.#gathering = setTimeout(() => this.#open(new Set()), after);
  }

  /// One selection per path: the fastest rate and the widest picture anybody wants.
  #selections(without: Set<string>) {
    const merged = new Map<string, { path: string; maxRateHz: number; thumbnailWidth: number }>();
    for (const { path, rate, width } of this.#wishes) {
      if (without.has(path)) continue;
      const had = merged.get(path);
      merged.set(path, {
        path,
        maxRateHz: Math.max(rate, had?.maxRateHz ?? 0),
        thumbnailWidth: Math.max(width, had?.thumbnailWidth ?? 0),
      });
    }
    return [...merged.values()];
  }

  async #open(without: Set<string>) {
    if (this.#away) return;
    const number = ++this.#running;
    const old = this.#now;
    const selections = this.#selections(without);
    if (selections.length === 0) {
      old?.abort();
      this.#now = null;
      this.#retryRefused(without);
      return;
    }
    const stop = (this.#now = new AbortController());
    const takers = new Map<string, Wish[]>();
    for (const wish of this.#wishes) takers.set(wish.path, [...(takers.get(wish.path) ?? []), wish]);
    try {
      const items = interact.subscribe(
        { selections },
        {
          signal: stop.signal,
          onHeader: () => {
            old?.abort();
            for (const s of selections) this.refused.delete(s.path);
          },
        },
      );
      this.#retryRefused(without);
      for await (const item of items) {
        if (item.skipped > 0n) this.skipped.set(item.path, (this.skipped.get(item.path) ?? 0) + Number(item.skipped));
        for (const wish of takers.get(item.path) ?? []) if (this.#wishes.has(wish)) wish.take(item);
      }
    } catch (error) {
      if (stop.signal.aborted || wasAborted(error)) return;
      if (number === this.#running && !isGone(error)) {
        const bad = await this.#whoIsRefused(selections, said(error));
        if (number === this.#running) {
          old?.abort();
          void this.#open(new Set([...without, ...bad]));
        }
        return;
      }
    }
    old?.abort();
    if (number === this.#running && !stop.signal.aborted) this.#changed(AGAIN);
  }

  /// What is refused now may be there later.
  #retryRefused(without: Set<string>) {
    if (without.size > 0) this.#changed(AGAIN * 3);
  }

  /// Each by itself, one after the other; the call is left as soon as it stands.
  async #whoIsRefused(selections: { path: string; maxRateHz: number; thumbnailWidth: number }[], why: string) {
    const bad: string[] = [];
    for (const selection of selections) {
      if (selections.length === 1) {
        this.refused.set(selection.path, why);
        return [selection.path];
      }
      const stop = new AbortController();
      try {
        for await (const _ of interact.subscribe({ selections: [selection] }, { signal: stop.signal, onHeader: () => stop.abort() })) break;
      } catch (error) {
        if (!stop.signal.aborted) {
          this.refused.set(selection.path, said(error));
          bad.push(selection.path);
        }
      }
      stop.abort();
    }
    return bad;
  }
}

export const live = new Live();

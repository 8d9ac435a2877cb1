/// Everything this page follows, in one Subscribe: events, outputs, thumbnails.
///
/// Invariant: a changed wish opens the new call before it leaves the old one, and of samples and events what both bring is given once,
/// in its order: no view stands still for it, nor misses an item, unless the old call is a second behind. One path that is refused
/// never takes the others along.
import { SvelteMap } from 'svelte/reactivity';
import { Eye, type SubscribeResponse } from '../gen/trocar/v1/interact_pb';
import { interact, isGone, said, wasAborted } from './api';
import { componentOf } from './words';

/// Changed wishes are gathered this long, ms.
const GATHER = 60;
/// Pause before the next try, ms.
const AGAIN = 1000;
/// The old call goes on this long beside the new one, ms: until it has brought what was made before the new one began. Where it is
/// far behind, so long at most: what it then still had is lost.
const TOGETHER = 100;
const MOST_TOGETHER = 1000;

export interface Wish {
  path: string;
  /// Hz; 0 = what the server thinks right.
  rate: number;
  /// Pixels; 0 = no picture.
  width: number;
  /// Image of a stereo pair that the picture shows; the left one where nobody says so.
  eye?: Eye;
  take: (item: SubscribeResponse) => void;
  /// What comes next does not follow what came last: the call ended, or the component began anew.
  lost?: () => void;
}

/// One Subscribe of this page.
class Call {
  stop = new AbortController();
  /// What came while the call before it still gives; null = it gives by itself.
  held: SubscribeResponse[] | null;
  /// How far the call before it had come, by path, ns: what is not newer was given. A path goes with its first item that is.
  known = new Map<string, bigint>();

  constructor(
    /// What is followed, and of pairs the image that was asked for.
    public paths: Map<string, Eye>,
    public before: Call | null,
  ) {
    this.held = before ? [] : null;
  }

  /// With all that were before it.
  leave() {
    this.stop.abort();
    this.before?.leave();
    this.before = null;
  }
}

class Live {
  /// Why a path cannot be followed.
  refused = new SvelteMap<string, string>();
  /// Items the server left out for this page, by path.
  skipped = new SvelteMap<string, number>();
  #wishes = new Map<string, Set<Wish>>();
  #now: Call | null = null;
  /// When the item of each path that was given last was made, ns.
  #newest = new Map<string, bigint>();
  #gathering: ReturnType<typeof setTimeout> | undefined;
  #away = false;

  /// Follows until the returned function is called.
  follow(wish: Wish): () => void {
    const same = this.#wishes.get(wish.path) ?? new Set();
    this.#wishes.set(wish.path, same.add(wish));
    this.#changed();
    return () => {
      same.delete(wish);
      if (same.size === 0 && this.#wishes.get(wish.path) === same) this.#wishes.delete(wish.path);
      this.#changed();
    };
  }

  /// A component began anew: what was followed of it has ended, and its stamps may be of another clock.
  renewed(path: string) {
    const followed = [...this.#wishes.keys()].filter((wished) => componentOf(wished) === path);
    for (const wished of followed) {
      this.#newest.delete(wished);
      this.#now?.known.delete(wished);
      this.#lose(wished);
    }
    if (followed.length > 0) this.#changed(GATHER * 4);
  }

  pause() {
    this.#away = true;
    this.#end();
  }

  resume() {
    if (!this.#away) return;
    this.#away = false;
    this.#changed();
  }

  #end() {
    this.#now?.leave();
    this.#now = null;
    this.#newest.clear();
    for (const path of this.#wishes.keys()) this.#lose(path);
  }

  #lose(path: string) {
    for (const wish of this.#wishes.get(path) ?? []) wish.lost?.();
  }

  #changed(after = GATHER) {
    clearTimeout(this.#gathering);
    this.#gathering = setTimeout(() => this.#open(new Set()), after);
  }

  /// One selection per path: the fastest rate and the widest picture anybody wants, of the eye that one of them names.
  #selections(without: Set<string>) {
    return [...this.#wishes]
      .filter(([path]) => !without.has(path))
      .map(([path, wishes]) => ({
        path,
        maxRateHz: Math.max(...[...wishes].map((w) => w.rate)),
        thumbnailWidth: Math.max(...[...wishes].map((w) => w.width)),
        eye: [...wishes].find((w) => w.eye !== undefined)?.eye ?? Eye.LEFT,
      }));
  }

  async #open(without: Set<string>) {
    if (this.#away) return;
    const selections = this.#selections(without);
    this.#retryRefused(without);
    if (selections.length === 0) {
      this.#end();
      return;
    }
    const call = (this.#now = new Call(new Map(selections.map((s) => [s.path, s.eye])), this.#now));
    const onHeader = () => {
      for (const s of selections) this.refused.delete(s.path);
      if (call.before) this.#takeOverSoon(call, MOST_TOGETHER / TOGETHER);
    };
    try {
      for await (const item of interact.subscribe({ selections }, { signal: call.stop.signal, onHeader })) {
        if (call.held) call.held.push(item);
        else this.#give(call, item);
      }
    } catch (error) {
      if (call.stop.signal.aborted || wasAborted(error)) return;
      if (call === this.#now && !isGone(error)) {
        const bad = await this.#whoIsRefused(selections, said(error));
        if (call !== this.#now) return;
        // What is followed already goes on until the rest of the new call stands.
        this.#now = call.before;
        call.before = null;
        void this.#open(new Set([...without, ...bad]));
        return;
      }
    }
    if (call !== this.#now || call.stop.signal.aborted) return;
    this.#takeOver(call);
    this.#end();
    this.#changed(AGAIN);
  }

  #takeOverSoon(call: Call, tries: number) {
    setTimeout(() => {
      if (!call.before || call.stop.signal.aborted) return;
      if (tries > 1 && this.#lags(call.before, call.held ?? [])) this.#takeOverSoon(call, tries - 1);
      else this.#takeOver(call);
    }, TOGETHER);
  }

  /// Whether a call has still to bring what was made before the first of these items was.
  #lags(call: Call, items: SubscribeResponse[]): boolean {
    const first = new Map<string, bigint>();
    for (const { path, stampNs } of items) if (call.paths.has(path) && !first.has(path)) first.set(path, stampNs);
    return [...first].some(([path, stampNs]) => (this.#newest.get(path) ?? -1n) < stampNs);
  }

  /// The call before it ends; what that one has not brought, this one gives.
  #takeOver(call: Call) {
    call.before?.leave();
    call.before = null;
    call.known = new Map(this.#newest);
    const held = call.held ?? [];
    call.held = null;
    for (const item of held) this.#give(call, item);
  }

  #give(call: Call, item: SubscribeResponse) {
    const known = call.known.get(item.path);
    if (known !== undefined) {
      if (item.stampNs <= known) return;
      call.known.delete(item.path);
    }
    this.#newest.set(item.path, item.stampNs);
    if (item.skipped > 0n) this.skipped.set(item.path, (this.skipped.get(item.path) ?? 0) + Number(item.skipped));
    for (const wish of this.#wishes.get(item.path) ?? []) {
      // A call that goes on beside the one of a new wish shows the eye of the old one.
      if (wish.eye === undefined || wish.eye === call.paths.get(item.path)) wish.take(item);
    }
  }

  /// What is refused now may be there later.
  #retryRefused(without: Set<string>) {
    if (without.size > 0) this.#changed(AGAIN * 3);
  }

  /// Each by itself, one after the other; the call is left as soon as it stands.
  async #whoIsRefused(selections: { path: string; maxRateHz: number; thumbnailWidth: number; eye: Eye }[], why: string) {
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

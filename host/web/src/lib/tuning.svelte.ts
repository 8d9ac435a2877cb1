/// Settings that change while a component runs, moved by hand and sent as they move.
///
/// Invariant: one Configure of a component is under way, ten begin a second, and the newest value goes: there
/// is no queue. The component's own value is shown, but while a hand moves it. A drag is one change for Undo.
import { ConnectError } from '@connectrpc/connect';
import { SvelteMap } from 'svelte/reactivity';
import { gcm, PATIENCE, said } from './api';
import { changes } from './changes.svelte';
import { merge, patch } from './patch';
import { fixedLength, isGroup, itemOf, kindOf, type Kind, type Schema, type Values } from './schema';
import { system } from './system.svelte';

/// Least time between two that are sent, ms.
const EVERY = 100;
/// Keys that follow each other this fast are one change, ms.
const ONE = 600;
/// An accepted value is shown so long at most before the component has told of it, ms.
const TELLS = 2000;
/// Arrays up to so many items have a control for each.
const MOST_ITEMS = 6;

export interface Setting {
  /// Key by key; the last may be the number of an item.
  at: string[];
  /// As it is called: limits.force[0].
  name: string;
  schema: Schema;
  kind: Kind;
  /// Length of the array it is an item of; 0: it is none.
  items: number;
}

const CONTROLS: Kind[] = ['number', 'integer', 'boolean', 'enum'];

/// Settings of a class that change while it runs and have a control here; `others` of them have none.
export function settingsOf(schema: Schema, at: string[] = []): { settings: Setting[]; others: string[] } {
  const settings: Setting[] = [];
  const others: string[] = [];
  for (const [key, part] of Object.entries(schema.properties ?? {})) {
    const here = [...at, key];
    const [kind, n] = [kindOf(part), fixedLength(part) ?? 0];
    if (kind === 'group') {
      const within = settingsOf(part, here);
      settings.push(...within.settings);
      others.push(...within.others);
    } else if (!part.live) continue;
    else if (CONTROLS.includes(kind)) settings.push({ at: here, name: here.join('.'), schema: part, kind, items: 0 });
    else if (kind === 'list' && n <= MOST_ITEMS && n > 0 && CONTROLS.includes(kindOf(itemOf(part)))) {
      for (let i = 0; i < n; i += 1) settings.push({ at: [...here, String(i)], name: `${here.join('.')}[${i}]`, schema: itemOf(part), kind: kindOf(itemOf(part)), items: n });
    } else others.push(here.join('.'));
  }
  return { settings, others };
}

export function valueAt(config: unknown, at: string[]): unknown {
  return at.reduce<unknown>((v, key) => (typeof v === 'object' && v !== null ? (v as Values)[key] : undefined), config);
}

/// The patch that sets it; an array goes as a whole.
function change(config: Values, { at, items }: Setting, value: unknown): Values {
  const keys = items ? at.slice(0, -1) : at;
  let part = value;
  if (items) {
    const all = valueAt(config, keys);
    part = Array.from({ length: items }, (_, i) => (i === Number(at.at(-1)) ? value : (all as unknown[] | undefined)?.[i]));
  }
  return keys.reduceRight<unknown>((inner, key) => ({ [key]: inner }), part) as Values;
}

class Tuned {
  /// By name of the setting: what a hand wants.
  wanted = new SvelteMap<string, unknown>();
  refused = new SvelteMap<string, string>();
  /// To be sent: the newest of each.
  #next: { patch: Values; names: Set<string> } | null = null;
  #busy = false;
  #working = Promise.resolve();
  /// The configuration before the hand came, and the parts accepted since.
  #before: Values | null = null;
  #accepted: Values = {};
  #held = false;
  #ending: ReturnType<typeof setTimeout> | undefined;
  /// Configuration as accepted, until the component tells the same.
  #expected: Values | null = null;
  /// Count of calls.
  sent = $state(0);

  constructor(readonly path: string) {}

  get config(): Values {
    return (system.components.get(this.path)?.config ?? {}) as Values;
  }

  value(s: Setting): unknown {
    return this.wanted.has(s.name) ? this.wanted.get(s.name) : (valueAt(this.config, s.at) ?? s.schema.default);
  }

  /// Moves it; `held`: the hand has not let go yet.
  move(s: Setting, value: unknown, held: boolean) {
    if (value === this.value(s)) return;
    clearTimeout(this.#ending);
    this.#before ??= structuredClone(this.config);
    this.#held = held;
    this.refused.delete(s.name);
    this.wanted.set(s.name, value);
    const base = merge(this.#expected ?? this.config, this.#next?.patch ?? {});
    const names = this.#next?.names ?? new Set<string>();
    this.#next = { patch: merge(this.#next?.patch ?? {}, change(base, s, value)), names: names.add(s.name) };
    if (!this.#busy) this.#working = this.#work();
  }

  /// All that was moved is answered and noted as a change, at once, and the component's own values are shown.
  async settled() {
    if (!this.#before) return;
    this.release(true);
    await this.#working;
    if (this.#before) return;
    this.#expected = null;
    this.wanted.clear();
  }

  /// The hand lets go: at once, or when no key follows.
  release(atOnce: boolean) {
    clearTimeout(this.#ending);
    const end = () => {
      this.#held = false;
      if (!this.#busy) this.#settle();
    };
    if (atOnce) end();
    else this.#ending = setTimeout(end, ONE);
  }

  async #work() {
    this.#busy = true;
    while (this.#next) {
      const began = performance.now();
      const { patch: config, names } = this.#next;
      this.#next = null;
      this.sent += 1;
      try {
        await gcm.configure({ path: this.path, config: config as never }, PATIENCE);
        this.#accepted = merge(this.#accepted, config);
        this.#expected = merge(this.#expected ?? this.config, config);
      } catch (error) {
        const why = said(ConnectError.from(error));
        // A newer value may be right.
        for (const name of names) {
          if ((this.#next as { names: Set<string> } | null)?.names.has(name)) continue;
          this.refused.set(name, why);
          this.wanted.delete(name);
        }
      }
      const rest = EVERY - (performance.now() - began);
      if (rest > 0) await new Promise((wake) => setTimeout(wake, rest));
    }
    this.#busy = false;
    if (!this.#held) this.#settle();
  }

  /// All that was sent is answered, and the hand is gone.
  #settle() {
    const [before, accepted] = [this.#before, this.#accepted];
    this.#before = null;
    this.#accepted = {};
    if (before && Object.keys(accepted).length) {
      const back = patch(merge(before, accepted), before);
      if (isGroup(back)) changes.configured(this.path, { config: accepted }, { config: back });
    }
    void this.#followed();
  }

  /// Shows the component's own values again, as soon as it has told of those it accepted.
  async #followed() {
    const expected = this.#expected;
    const until = performance.now() + TELLS;
    while (expected && patch(this.config, expected) && performance.now() < until) {
      await new Promise((wake) => setTimeout(wake, 30));
      if (this.#before || this.#expected !== expected) return;
    }
    if (this.#before) return;
    this.#expected = null;
    this.wanted.clear();
  }
}

const all = new Map<string, Tuned>();

export function tuned(path: string): Tuned {
  const one = all.get(path) ?? new Tuned(path);
  all.set(path, one);
  return one;
}

// A change that is noted late would be taken back after an older one.
changes.settled = () => Promise.all([...all.values()].map((one) => one.settled()));

export type { Tuned };

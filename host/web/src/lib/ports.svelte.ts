/// What components offer: their class's ports at once, their own as soon as they are asked.
///
/// Invariant: one question at a time; whoever is looked at is asked first.
import { SvelteMap } from 'svelte/reactivity';
import type { ClassInfo, Command, Event, Ports, PortType, TypeInfo } from '../gen/trocar/v1/types_pb';
import { gcm } from './api';
import { system } from './system.svelte';
import { count } from './words';

export type PortKind = 'input' | 'output' | 'required' | 'provided';

export interface Port {
  name: string;
  kind: PortKind;
  doc: string;
  tag: string;
  optional: boolean;
  /// Name and hash of what passes; the hash decides the colour.
  type: string;
  hash: string;
  /// A frame with an image in it.
  image: boolean;
  /// Two images, one for each eye.
  pair: boolean;
  frame: boolean;
  any: boolean;
  /// Every component has it, without any code.
  tap: boolean;
}

export interface Described {
  ports: Port[];
  raw: Ports;
  /// True once the component itself was asked.
  own: boolean;
}

class Offers {
  of = new SvelteMap<string, Described>();
  classes = new SvelteMap<string, ClassInfo>();
  /// Whether taps are drawn that nothing is connected to: three at each component.
  taps = $state(false);
  #used = $derived(new Set([...system.connections.values()].map((c) => c.server)));
  /// What was drawn of a component last, for as long as that is the same.
  #drawn = new Map<string, Port[]>();
  /// Classes by process.
  #asked = new Set<string>();
  #queue: string[] = [];
  #busy = false;

  async learnClasses() {
    const list = await gcm.list({ classes: true, brief: true }, { timeoutMs: 8000 });
    const seen = new Set<string>();
    for (const info of list.classes) {
      const name = `${info.plugin}/${info.name}`;
      seen.add(name);
      this.classes.set(name, info);
    }
    for (const name of [...this.classes.keys()]) if (!seen.has(name)) this.classes.delete(name);
  }

  /// Makes sure that something is known of everything that is there.
  catchUp() {
    for (const c of system.components.values()) {
      if (!this.of.has(c.path)) {
        const info = this.classes.get(c.class);
        if (info?.ports) this.of.set(c.path, { ports: flat(info.ports), raw: info.ports, own: false });
      }
      if (!this.#asked.has(c.path)) this.#ask(c.path, false);
    }
    for (const path of [...this.of.keys()]) if (!system.components.has(path)) this.#forget(path);
    for (const c of system.connections.values()) {
      for (const end of [c.client, c.server]) {
        const path = end.split('/').slice(0, 2).join('/');
        const known = this.of.get(path);
        if (known?.own && !known.ports.some((p) => `${path}/${p.name}` === end)) this.#ask(path, false);
      }
    }
  }

  /// Asks again, before all others.
  look(path: string) {
    this.#ask(path, true);
  }

  /// The ports that are drawn of a component.
  drawn(path: string): Port[] {
    const all = this.of.get(path)?.ports ?? [];
    const ports = this.taps ? all : all.filter((p) => !p.tap || this.#used.has(`${path}/${p.name}`));
    const last = this.#drawn.get(path);
    if (last?.length === ports.length && last.every((p, i) => p === ports[i])) return last;
    this.#drawn.set(path, ports);
    return ports;
  }

  port(path: string): Port | undefined {
    const [process, component, name] = path.split('/');
    return this.of.get(`${process}/${component}`)?.ports.find((p) => p.name === name);
  }

  #forget(path: string) {
    this.of.delete(path);
    this.#drawn.delete(path);
    this.#asked.delete(path);
  }

  #ask(path: string, first: boolean) {
    this.#asked.add(path);
    this.#queue = this.#queue.filter((p) => p !== path);
    if (first) this.#queue.unshift(path);
    else this.#queue.push(path);
    void this.#work();
  }

  async #work() {
    if (this.#busy) return;
    this.#busy = true;
    for (let path = this.#queue.shift(); path; path = this.#queue.shift()) {
      try {
        const answer = await gcm.describe({ path }, { timeoutMs: 4000 });
        if (answer.ports) this.of.set(path, { ports: flat(answer.ports), raw: answer.ports, own: true });
        if (answer.class) this.classes.set(`${answer.class.plugin}/${answer.class.name}`, answer.class);
      } catch {
        // Asked again when it is looked at, or when it is there again.
        this.#asked.delete(path);
      }
    }
    this.#busy = false;
  }
}

export const offers = new Offers();

function typed(t: PortType | undefined): Pick<Port, 'type' | 'hash' | 'image' | 'pair' | 'frame' | 'any'> {
  switch (t?.kind.case) {
    case 'plain':
      return { type: t.kind.value.name, hash: t.kind.value.hash, image: false, pair: false, frame: false, any: false };
    case 'frame': {
      const header = t.kind.value.header;
      const fields = header?.shape.case === 'structure' ? header.shape.value.fields.map((f) => f.name) : [];
      const image = ['width', 'height', 'stride', 'format'].every((f) => fields.includes(f));
      const pair = image && fields.includes('right_offset');
      return { type: `${header?.name ?? ''} + bytes`, hash: header?.hash ?? '', image, pair, frame: true, any: false };
    }
    default:
      return { type: 'takes the type of what it is connected to', hash: '', image: false, pair: false, frame: false, any: true };
  }
}

const INTERFACE = { hash: '', image: false, pair: false, frame: false, any: false, tap: false };

/// Every component has an interface `system`: it comes after all that is its own.
export function systemLast<T extends { name: string }>(provided: T[]): T[] {
  return [...provided.filter((p) => p.name !== 'system'), ...provided.filter((p) => p.name === 'system')];
}

export function tapsLast<T extends { tap: boolean }>(outputs: T[]): T[] {
  return [...outputs.filter((o) => !o.tap), ...outputs.filter((o) => o.tap)];
}

/// As they are drawn: on each side of a card from top to bottom.
function flat(ports: Ports): Port[] {
  return [
    ...ports.inputs.map((p): Port => ({ name: p.name, kind: 'input', doc: p.doc, tag: p.tag, optional: p.optional, tap: false, ...typed(p.type) })),
    ...ports.required.map(
      (p): Port => ({ name: p.name, kind: 'required', doc: p.doc, tag: '', optional: p.optional, type: `${count(p.functions.length, 'function')}, ${count(p.handlers.length, 'handler')}`, ...INTERFACE }),
    ),
    ...tapsLast(ports.outputs).map((p): Port => ({ name: p.name, kind: 'output', doc: p.doc, tag: p.tag, optional: true, tap: p.tap, ...typed(p.type) })),
    ...systemLast(ports.provided).map(
      (p): Port => ({ name: p.name, kind: 'provided', doc: p.doc, tag: p.tag, optional: true, type: `${count(p.commands.length, 'command')}, ${count(p.events.length, 'event')}`, ...INTERFACE }),
    ),
  ];
}

export function isClient(kind: PortKind): boolean {
  return kind === 'input' || kind === 'required';
}

/// Can never be joined, whatever the server would say in detail; empty = worth asking.
export function plainlyWrong(client: Port, server: Port): string {
  if (!isClient(client.kind) || isClient(server.kind)) return 'a connection joins a required interface to a provided one, or an input to an output';
  if ((client.kind === 'input') !== (server.kind === 'output')) {
    return client.kind === 'input' ? 'an input takes an output, not an interface' : 'a required interface takes a provided one, not an output';
  }
  if (client.kind === 'input' && !client.any && !server.any && client.hash !== server.hash) {
    return `it takes ${client.type}, and that gives ${server.type}`;
  }
  return '';
}

/// Items of an array or a list whose numbers are offered: of an image's row nobody wants a button each.
export const OFFERED = 16;

/// A value by its name, of an enum.
export type Names = Record<string, number>;

export interface InType {
  /// As it is in JSON: "position[0]"; empty = the value itself.
  path: string;
  unit: string;
  /// Where it is one of several names.
  names?: Names;
  /// Why it is not offered; empty = it is a number.
  why: string;
}

/// All that a value of the type holds: numbers, and what is not offered as one.
export function partsOf(t: TypeInfo | undefined, path = '', unit = ''): InType[] {
  if (!t) return [];
  switch (t.shape.case) {
    case 'primitive':
      return [{ path, unit, why: '' }];
    case 'enumeration':
      return [{ path, unit, why: '', names: Object.fromEntries(t.shape.value.values.map((v) => [v.name, Number(v.number)])) }];
    case 'array':
    case 'list': {
      const { item, n } = t.shape.value;
      const parts = Array.from({ length: Math.min(n, OFFERED) }, (_, i) => partsOf(item, `${path}[${i}]`, unit)).flat();
      return n > OFFERED && parts.some((p) => p.why === '') ? [...parts, { path: `${path}[${OFFERED}…${n - 1}]`, unit, why: `more than ${OFFERED} items` }] : parts;
    }
    case 'structure':
      return t.shape.value.fields.flatMap((f) => partsOf(f.type, path ? `${path}.${f.name}` : f.name, f.unit || unit));
    case 'text':
      return [{ path, unit, why: 'text' }];
    default:
      return [];
  }
}

/// The number at such a path, of an enum the one its name stands for; NaN where there is none.
export function pick(value: unknown, path: string, names?: Names): number {
  let at: unknown = value;
  for (const part of path.split(/[.[\]]+/)) {
    if (part === '') continue;
    if (at === null || typeof at !== 'object') return Number.NaN;
    at = (at as Record<string, unknown>)[part];
  }
  if (typeof at === 'boolean') return at ? 1 : 0;
  if (typeof at === 'string') return names?.[at] ?? (at === 'NaN' ? Number.NaN : Number(at));
  return typeof at === 'number' ? at : Number.NaN;
}

export type { Command, Event };

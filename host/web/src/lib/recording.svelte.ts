/// The recordings of the system, whoever began them, and how this page begins and ends one.
///
/// Invariant: a recording is never lost from sight: it goes on without any page, each page finds it in the
/// graph, and its end is shown until somebody has read it. A start that is refused leaves no recorder behind.
import { Code, ConnectError } from '@connectrpc/connect';
import { SvelteMap } from 'svelte/reactivity';
import { ComponentState, Health, type Component } from '../gen/trocar/v1/types_pb';
import { gcm, interact, isGone, PATIENCE, plain, said, wrapped, type Json } from './api';
import { live } from './live.svelte';
import { makeRecorder, type Wanted } from './recorder';
import { page } from './page.svelte';
import { RECORDER } from './sources';
import { system } from './system.svelte';
import { lastPart } from './words';

/// The name of recorders of viewers, with a number behind it where it is taken. Any viewer takes them away
/// once they have recorded.
export const OURS = 'rec-viewer';
/// Between two looks at the recorders, ms.
const EVERY = 500;
/// A slow disk may take this long to close a file, s.
const CLOSING = 60n;
/// Ends, and outputs left out, that are kept over a reload.
const KEPT = 20;
/// A recorder of a viewer is being made, or made ready, for so many looks before it counts as left behind.
const LOOKS = 10;
/// Two looks at one recording find its beginning within this, ns.
const SAME_NS = 0.5e9;
/// A page that looks sees an end within this, ns.
const LOOKING_NS = 2e9;
const SINCE = 'another recording was begun since';

export interface Recording {
  component: string;
  file: string;
  phase: string;
  /// s.
  elapsed: number;
  bytes: number;
  messages: number;
  lost: number;
  interrupted: number;
  /// Outputs of which something came.
  topics: number;
  /// When it began, and when it ended while its file is being closed (0 = it goes on): ns of the host's
  /// monotonic clock.
  beganNs: number;
  endedNs: number;
  /// The process of the recorder does not answer: the numbers are the last ones known.
  unheard: boolean;
  /// Outputs that this page wanted and could not connect, a sentence each.
  leftOut: string[];
}

export interface Ended {
  component: string;
  file: string;
  reason: string;
  bytes: number;
  messages: number;
  lost: number;
  interrupted: number;
  /// s; absent: it ended while no page looked.
  lasted?: number;
  /// The file has its index and its end.
  whole: boolean;
  /// The recorder told so itself; else these are the last numbers the page knew.
  told: boolean;
  /// Outputs with losses or interruptions, a sentence each.
  missing: string[];
  /// Outputs that were connected and gave nothing.
  silent: number;
  /// As in Recording.
  leftOut: string[];
}

type Values = { [key: string]: Json };
const number = (values: Values, key: string) => Number(values[key] ?? 0);
const values = (json: Json): Values => (json !== null && typeof json === 'object' && !Array.isArray(json) ? json : {});

class Recordings {
  /// The panel is open.
  open = $state(false);
  /// Recordings that are made, by recorder.
  running = new SvelteMap<string, Recording>();
  ended = $state.raw<Ended[]>(remembered<Ended>('recordings').map((one) => ({ ...one, leftOut: one.leftOut ?? [] })));
  /// Recorders of viewers that record nothing and have nothing to tell.
  idle = $state.raw<string[]>([]);
  /// Words for the work at this moment; empty = nothing is done.
  doing = $state('');
  #making = '';
  /// Outputs left out of the recording that is being begun: its file is not known yet.
  #beginning: { component: string; leftOut: string[] } | undefined;
  /// The same of recordings that were begun here, by file: no other recording has that.
  #leftOut = new Map<string, string[]>(remembered('left-out'));
  /// Looks in a row that found a recorder with nothing to record, by recorder, and how it stood.
  #idled = new Map<string, { stood: string; looks: number }>();
  /// Files whose end was read.
  #read = new Set<string>();
  /// Recorders whose end is being told: they are taken away next.
  #ending = new Set<string>();
  /// Recorders that could not be taken away yet: their process is being started again.
  #leaving = new Set<string>();
  #heard = new Map<string, () => void>();
  /// Ends that were told.
  #ends = 0;
  #looking: Promise<void> | undefined;
  #stop = false;

  /// Looks at the recorders until the returned function is called.
  follow(): () => void {
    this.#stop = false;
    void (async () => {
      while (!this.#stop) {
        if (!document.hidden && system.standing === 'live') await this.#look();
        await new Promise((wake) => setTimeout(wake, EVERY));
      }
    })();
    return () => (this.#stop = true);
  }

  async start(wanted: Wanted): Promise<string> {
    try {
      const component = await makeRecorder(wanted, OURS, (doing, path) => {
        this.doing = doing;
        if (path) this.#making = path;
      }, (path, leftOut) => (this.#beginning = { component: path, leftOut }));
      page.tell(`${component} records`);
      return '';
    } catch (error) {
      this.#beginning = undefined;
      return error instanceof ConnectError ? said(error) : (error as Error).message;
    } finally {
      this.#making = '';
      await this.#look();
      this.doing = '';
    }
  }

  /// Ends a recording; answers a refusal.
  async stop(component: string): Promise<string> {
    try {
      const call = { path: `${component}/ctl/stop` };
      const answer = await gcm.waitFor({ path: `${component}/ctl/stopped`, deadline: { seconds: CLOSING }, call }, { timeoutMs: Number(CLOSING) * 1000 + 5000 });
      await this.#over(component, values(plain(answer.json)), Number(answer.stampNs));
      return '';
    } catch (error) {
      // The recording may have ended by itself just then.
      await this.#look();
      return this.running.has(component) ? said(error) : '';
    }
  }

  /// Takes away a recorder that records nothing; answers why it stays.
  async remove(component: string): Promise<string> {
    try {
      // Somebody may have begun a recording with it since it was listed.
      const phase = await this.#phase(component);
      if (phase !== 'IDLE') return `${component} is not taken away: it records by now (${phase})`;
    } catch (error) {
      if (ConnectError.from(error).code !== Code.NotFound) return said(error);
    }
    return await this.#takeAway(component);
  }

  async #takeAway(component: string): Promise<string> {
    try {
      await gcm.remove({ path: component, force: true }, PATIENCE);
    } catch (error) {
      // Another page may have done it.
      if (ConnectError.from(error).code !== Code.NotFound) return said(error);
    }
    this.#leaving.delete(component);
    return '';
  }

  dismiss(one: Ended) {
    this.#read.add(one.file);
    this.#leftOut.delete(one.file);
    this.#keep(this.ended.filter((other) => other !== one));
  }

  /// One look at a time: what it saw is not older than what another one did with it.
  async #look() {
    while (this.#looking) await this.#looking;
    this.#looking = this.#lookOnce().finally(() => (this.#looking = undefined));
    await this.#looking;
  }

  async #lookOnce() {
    for (const path of this.#leaving) if (!system.components.has(path)) this.#leaving.delete(path);
    const recorders = [...system.components.values()].filter((c) => c.class === RECORDER);
    // All at once: one that answers late holds up no other.
    const found = await Promise.all(recorders.map(async (c) => {
      this.#hear(c.path);
      if (c.path === this.#making) return false;
      try {
        return await this.#ask(c);
      } catch (error) {
        // A recorder whose process is gone is still shown; one that is gone itself is looked for below.
        if (isGone(error) || ConnectError.from(error).code === Code.DeadlineExceeded) this.#unheard(c.path);
        return false;
      }
    }));
    const idle = this.#leftBehind(recorders.filter((_, n) => found[n]));
    if (idle.join() !== this.idle.join()) this.idle = idle;
    for (const [path, leave] of this.#heard) {
      if (system.components.has(path)) continue;
      leave();
      this.#heard.delete(path);
      const was = this.running.get(path);
      if (was) this.#show(lastKnown(was, 'its recorder was taken away'));
      this.running.delete(path);
    }
  }

  /// Recorders that stood idle for long enough: another viewer may still be making one.
  #leftBehind(idle: Component[]): string[] {
    const before = this.#idled;
    this.#idled = new Map();
    for (const { path, state } of idle) {
      const ties = [...system.connections.values()].filter((tie) => tie.client.startsWith(`${path}/`)).length;
      const stood = `${state} ${ties}`;
      const was = before.get(path);
      this.#idled.set(path, { stood, looks: was?.stood === stood ? was.looks + 1 : 1 });
    }
    return [...this.#idled].filter(([, { looks }]) => looks >= LOOKS).map(([path]) => path);
  }

  #unheard(component: string) {
    const was = this.running.get(component);
    if (was && !was.unheard) this.running.set(component, { ...was, unheard: true });
  }

  /// The end of a recording is told once: whoever made it may take its recorder away right then.
  #hear(component: string) {
    if (this.#heard.has(component)) return;
    const take = (item: { json?: Parameters<typeof plain>[0]; stampNs: bigint }) => void this.#over(component, values(plain(item.json)), Number(item.stampNs));
    this.#heard.set(component, live.follow({ path: `${component}/ctl/stopped`, rate: 0, width: 0, take }));
  }

  /// True: the recorder is a viewer's, and has nothing to record nor to tell.
  async #ask({ path, state, health }: Component): Promise<boolean> {
    const was = this.running.get(path);
    if (health === Health.LOST) {
      this.#unheard(path);
      return false;
    }
    if (!was && state !== ComponentState.ACTIVE) return isOurs(path);
    const ends = this.#ends;
    const answer = await this.#get(path, 'status');
    const status = values(plain(answer.json));
    const phase = String(status.phase);
    if (phase !== 'IDLE') {
      const elapsed = number(status, 'elapsed');
      const beganNs = Number(answer.stampNs) - elapsed * 1e9;
      const isSame = was && was.elapsed <= elapsed && Math.abs(beganNs - was.beganNs) < SAME_NS;
      const file = isSame ? was.file : String(plain((await this.#get(path, 'path')).json));
      const counts = { bytes: number(status, 'bytes'), messages: number(status, 'messages'), lost: number(status, 'lost'), interrupted: number(status, 'interrupted'), topics: number(status, 'topics') };
      // Its end may have been told meanwhile.
      if (ends !== this.#ends) return false;
      if (was && file !== was.file) await this.#replaced(was);
      if (file) {
        // A file of that name was told of before, and is gone.
        this.#read.delete(file);
        if (this.ended.some((one) => one.file === file)) this.#keep(this.ended.filter((one) => one.file !== file));
        this.running.set(path, { component: path, file, phase, elapsed, ...counts, beganNs, endedNs: 0, unheard: false, leftOut: this.#leftOf(path, file) });
      }
      return false;
    }
    if (!was && !isOurs(path)) return false;
    // The file has its name until it is closed.
    if (was && String(plain((await this.#get(path, 'path')).json)) === was.file) {
      if (!was.endedNs && this.running.has(path)) this.running.set(path, { ...was, phase: 'CLOSING', endedNs: Number(answer.stampNs), unheard: false });
      return false;
    }
    const last = values(plain((await this.#get(path, 'last')).json));
    if (last.reason && (!was || last.path === was.file)) {
      // Told already: its recorder should have gone.
      if (!(await this.#over(path, last, 0)) && !this.#ending.has(path)) return isOurs(path) && !(await this.#leave(path));
    } else if (was && this.running.delete(path)) {
      // A process that ended has no recording behind it.
      this.#show(lastKnown(was, last.reason ? SINCE : 'its process ended while it recorded'));
      if (last.reason && last.path) await this.#over(path, last, 0);
      else if (!last.reason) await this.#leave(path);
    } else return isOurs(path) && !(this.#leaving.has(path) && (await this.#leave(path)));
    return false;
  }

  /// Its recorder began another recording while this page did not look.
  async #replaced(was: Recording) {
    const last = values(plain((await this.#get(was.component, 'last')).json));
    if (last.reason && last.path === was.file) await this.#over(was.component, last, 0, false);
    else if (this.running.delete(was.component)) this.#show(lastKnown(was, SINCE));
  }

  async #phase(component: string): Promise<string> {
    return String(values(plain((await this.#get(component, 'status')).json)).phase);
  }

  #leftOf(component: string, file: string): string[] {
    if (this.#beginning?.component === component) {
      this.#leftOut.set(file, this.#beginning.leftOut);
      this.#beginning = undefined;
      remember('left-out', [...this.#leftOut].slice(-KEPT));
    }
    return this.#leftOut.get(file) ?? [];
  }

  #get(component: string, command: string, json?: Json) {
    return interact.invoke({ path: `${component}/ctl/${command}`, json: json === undefined ? undefined : wrapped(json) }, { timeoutMs: 3000 });
  }

  /// The recorder told how its recording ended; `atNs`: when, 0 = not known; `rests`: it makes no other now.
  /// Answers whether that was news.
  async #over(component: string, last: Values, atNs: number, rests = true): Promise<boolean> {
    const was = this.running.get(component);
    this.running.delete(component);
    const file = String(last.path ?? '');
    const before = this.ended.find((one) => one.file === file);
    if (!was && (this.#read.has(file) || before?.told)) return false;
    this.#ends += 1;
    this.#ending.add(component);
    const sources = (system.components.get(component)?.config?.sources as string[] | undefined) ?? [];
    const leftOut = this.#leftOf(component, file);
    const connected = sources.filter((source) => !leftOut.some((sentence) => sentence.startsWith(`${source}: `))).length;
    const one: Ended = {
      component,
      file,
      reason: String(last.reason),
      bytes: number(last, 'bytes'),
      messages: number(last, 'messages'),
      lost: number(last, 'lost'),
      interrupted: number(last, 'interrupted'),
      lasted: (was && lastedOf(was, atNs)) ?? before?.lasted,
      whole: last.whole === true,
      told: true,
      missing: [],
      silent: was ? Math.max(0, connected - was.topics) : 0,
      leftOut,
    };
    this.#show(one);
    if (rests && one.lost + one.interrupted > 0) this.#show({ ...one, missing: await this.#missing(component, sources.length) });
    if (rests) await this.#leave(component);
    this.#ending.delete(component);
    return true;
  }

  /// A viewer's recorder goes with its recording; while it cannot, it is tried again at each look.
  async #leave(component: string): Promise<boolean> {
    if (!isOurs(component) || page.readonly) return false;
    this.#leaving.add(component);
    // Somebody may have begun another recording with it; one that does not answer records nothing.
    if ((await this.#phase(component).catch(() => 'IDLE')) !== 'IDLE') return false;
    return (await this.#takeAway(component)) === '';
  }

  async #missing(component: string, outputs: number): Promise<string[]> {
    const found: string[] = [];
    for (let n = 0; n < outputs; n += 1) {
      const answer = await this.#get(component, 'topic', n).catch(() => undefined);
      if (!answer) break;
      const topic = values(plain(answer.json));
      const [lost, times] = [number(topic, 'lost'), number(topic, 'interrupted')];
      if (lost) found.push(`${String(topic.topic)}: ${lost} lost`);
      if (times) found.push(`${String(topic.topic)}: its connection or the process of its source went away ${times === 1 ? 'once' : `${times} times`}`);
    }
    return found;
  }

  /// A file has one end, the newest that is known of it.
  #show(one: Ended) {
    this.#keep([one, ...this.ended.filter((other) => other.file !== one.file)]);
  }

  #keep(ended: Ended[]) {
    this.ended = ended;
    remember('recordings', ended.slice(0, KEPT));
  }
}

/// For this window, when it is loaded anew.
function remember(key: string, items: unknown[]) {
  try {
    sessionStorage.setItem(key, JSON.stringify(items));
  } catch {
    // They are then known as long as the page is open.
  }
}

function remembered<T>(key: string): T[] {
  try {
    return JSON.parse(sessionStorage.getItem(key) ?? '[]') as T[];
  } catch {
    return [];
  }
}

/// s; absent: the page did not look when it ended.
function lastedOf(was: Recording, atNs: number): number | undefined {
  const endedNs = was.endedNs || atNs;
  const seenNs = was.beganNs + was.elapsed * 1e9;
  // A file that was found closing after an absence began to close at some time in it.
  if (endedNs === 0 || (was.endedNs && endedNs - seenNs > LOOKING_NS)) return undefined;
  return Math.max(0, (endedNs - was.beganNs) / 1e9);
}

export function isOurs(component: string): boolean {
  return new RegExp(`^${OURS}(-\\d+)?$`).test(lastPart(component));
}

/// The program that made a recorder, by the name it gives.
export function madeBy(component: string): string {
  const name = lastPart(component);
  if (isOurs(component)) return 'a viewer';
  if (/^rec-\d+$/.test(name)) return 'trocar record';
  return name.startsWith('rec_') ? 'Python' : 'the system';
}

function lastKnown(was: Recording, reason: string): Ended {
  const { component, file, bytes, messages, lost, interrupted, elapsed, leftOut } = was;
  return { component, file, reason, bytes, messages, lost, interrupted, lasted: elapsed, whole: false, told: false, missing: [], silent: 0, leftOut };
}

export const recordings = new Recordings();

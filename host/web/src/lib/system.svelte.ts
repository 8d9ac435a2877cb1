/// The system graph as Watch tells it, kept live over every loss of the server.
///
/// Invariant: what is on the screen is what the last message said; while nobody answers, the page says since
/// when. A process has a time only of a change that was seen to happen.
import { SvelteMap } from 'svelte/reactivity';
import type { Delta, Snapshot } from '../gen/trocar/v1/gcm_pb';
import type { Component, Connection, Process } from '../gen/trocar/v1/types_pb';
import { gcm, said } from './api';

/// Pause before the next try, ms.
const AGAIN = 500;

class System {
  processes = new SvelteMap<string, Process>();
  components = new SvelteMap<string, Component>();
  connections = new SvelteMap<string, Connection>();
  /// When the page saw a process come to its present state, ms; absent: nobody looked then.
  since = new SvelteMap<string, number>();
  revision = $state(0n);
  term = $state(0n);
  /// 'joining' before the first message, 'live', or 'away' with since when and why.
  standing = $state<'joining' | 'live' | 'away'>('joining');
  awaySince = $state(0);
  why = $state('');
  /// Counts its returns.
  returns = $state(0);
  /// Counts changes of what there is, rather than of how it stands: the picture is laid out anew.
  shape = $state(0);
  /// Told of paths of components whose run changed: followers ask again for those.
  onRenewed: (path: string) => void = () => {};

  #stop: AbortController | null = null;
  /// Cursor of the last message.
  #cursor = '';

  /// Follows until `pause` is called.
  async follow() {
    if (this.#stop) return;
    const stop = (this.#stop = new AbortController());
    while (!stop.signal.aborted) {
      try {
        let returned = this.#cursor !== '';
        for await (const news of gcm.watch({ after: this.#cursor }, { signal: stop.signal })) {
          if (this.standing === 'away') this.returns += 1;
          this.standing = 'live';
          // The last of several pages has it.
          this.#cursor = news.cursor;
          this.revision = news.revision;
          this.term = news.term;
          if (news.news.case === 'snapshot') this.#snapshot(news.news.value);
          else if (news.news.case === 'delta') this.#delta(news.news.value, returned);
          returned = false;
        }
        if (!stop.signal.aborted) this.#away('it ended the call');
      } catch (error) {
        if (!stop.signal.aborted) this.#away(said(error));
      }
      if (!stop.signal.aborted) await new Promise((wake) => setTimeout(wake, AGAIN));
    }
  }

  /// Lets go of the call: a page nobody sees holds none of the few a browser may have.
  pause() {
    this.#stop?.abort();
    this.#stop = null;
  }

  #away(why: string) {
    if (this.standing !== 'away') this.awaySince = Date.now();
    this.standing = 'away';
    this.why = why;
  }

  #snapshot(all: Snapshot) {
    const names = new Set(all.processes.map((p) => p.name));
    const paths = new Set(all.components.map((c) => c.path));
    const ids = new Set(all.connections.map((c) => String(c.id)));
    for (const name of [...this.processes.keys()]) if (!names.has(name)) this.#gone(name);
    for (const path of [...this.components.keys()]) if (!paths.has(path)) this.components.delete(path);
    for (const id of [...this.connections.keys()]) if (!ids.has(id)) this.connections.delete(id);
    // A change found after an absence happened at some time in it.
    for (const p of all.processes) if (this.#isNews(p)) this.since.delete(p.name);
    this.#take(all.processes, all.components, all.connections);
    for (const path of paths) this.onRenewed(path);
    this.shape += 1;
  }

  /// `returned`: it is the first one after an absence, and what it tells happened at some time in it.
  #delta(delta: Delta, returned: boolean) {
    let reshaped = false;
    for (const name of delta.removedProcesses) reshaped = this.#gone(name) || reshaped;
    for (const path of delta.removedComponents) reshaped = this.components.delete(path) || reshaped;
    for (const id of delta.removedConnections) this.connections.delete(String(id));
    reshaped ||= delta.processes.some((p) => !this.processes.has(p.name));
    reshaped ||= delta.components.some((c) => !this.components.has(c.path));
    const before = new Map(delta.processes.map((p) => [p.name, this.processes.get(p.name)]));
    const stood = new Map(delta.components.map((c) => [c.path, this.components.get(c.path)?.state]));
    for (const p of delta.processes.filter((p) => this.#isNews(p))) {
      if (returned) this.since.delete(p.name);
      else this.since.set(p.name, Date.now());
    }
    this.#take(delta.processes, delta.components, delta.connections);
    for (const p of delta.processes) {
      const old = before.get(p.name);
      if (old && (old.epoch !== p.epoch || old.state !== p.state)) {
        for (const path of this.components.keys()) if (path.startsWith(`${p.name}/`)) this.onRenewed(path);
      }
    }
    for (const c of delta.components) if (stood.get(c.path) !== c.state) this.onRenewed(c.path);
    // Whoever followed a component was cut off, too.
    if (returned) for (const path of this.components.keys()) this.onRenewed(path);
    if (reshaped) this.shape += 1;
  }

  #isNews(p: Process): boolean {
    const old = this.processes.get(p.name);
    return old?.state !== p.state || old.epoch !== p.epoch;
  }

  #gone(process: string): boolean {
    this.since.delete(process);
    return this.processes.delete(process);
  }

  #take(processes: Process[], components: Component[], connections: Connection[]) {
    for (const p of processes) this.processes.set(p.name, p);
    for (const c of components) {
      // Watch tells no figures: those of the last look stay until the next one.
      c.stats ??= this.components.get(c.path)?.stats;
      this.components.set(c.path, c);
    }
    for (const c of connections) this.connections.set(String(c.id), c);
  }
}

export const system = new System();

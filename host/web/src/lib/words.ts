/// Words, colours and numbers as people read them.
import { ComponentState, Health, ProcessState, StopReason, type Component, type Process } from '../gen/trocar/v1/types_pb';

export type Tone = 'good' | 'idle' | 'new' | 'warn' | 'bad' | 'gone';

const STATE: Record<number, [string, Tone]> = {
  [ComponentState.CREATED]: ['CREATED', 'new'],
  [ComponentState.READY]: ['READY', 'idle'],
  [ComponentState.ACTIVE]: ['ACTIVE', 'good'],
  [ComponentState.STOPPED]: ['STOPPED', 'warn'],
  [ComponentState.FAULT]: ['FAULT', 'bad'],
};

const HEALTH: Record<number, [string, Tone, string]> = {
  [Health.OK]: ['OK', 'good', 'nothing to report'],
  [Health.OVERRUN]: ['OVERRUN', 'warn', 'its step takes longer than its period'],
  [Health.STALE_INPUT]: ['STALE_INPUT', 'warn', 'a required input had no fresh data, or a required connection is gone'],
  [Health.UNRESPONSIVE]: ['UNRESPONSIVE', 'bad', 'it makes no progress'],
  [Health.LOST]: ['LOST', 'gone', 'its process does not answer; the state is the last one known'],
};

export function stateOf(c: Component): { text: string; tone: Tone } {
  const [word, tone] = STATE[c.state] ?? ['?', 'new'];
  const why = c.state === ComponentState.STOPPED ? StopReason[c.stopReason] : '';
  return { text: why && why !== 'UNSPECIFIED' ? `${word} · ${why.toLowerCase().replaceAll('_', ' ')}` : word, tone };
}

/// Why nothing new comes from a component; empty = it may.
export function whyStill(path: string, c: Component | undefined): string {
  if (!c) return `${path} no longer exists`;
  if (c.health === Health.LOST) return `${path}: its process does not answer`;
  return c.state === ComponentState.ACTIVE ? '' : `${path} is ${stateOf(c).text}`;
}

export function healthOf(c: Component): { text: string; tone: Tone; why: string } {
  const [text, tone, means] = HEALTH[c.health] ?? ['unknown', 'new', 'not reported'];
  const details = [...(c.stats?.warnings ?? [])];
  const overruns = c.stats?.overruns ?? 0n;
  if (overruns > 0n) details.push(`${count(Number(overruns), 'overrun')} since it was made`);
  // A warning is something to report.
  if (c.fault || c.health !== Health.OK || details.length === 0) details.unshift(c.fault || means);
  return { text, tone: c.fault ? 'bad' : tone, why: details.join('; ') };
}

export function processOf(p: Process): { text: string; tone: Tone } {
  switch (p.state) {
    case ProcessState.ATTACHED:
      return { text: p.guest || 'attached', tone: p.warnings.length ? 'warn' : 'good' };
    case ProcessState.RESTARTING:
      return { text: 'restarting', tone: 'warn' };
    case ProcessState.FAILED:
      return { text: 'failed', tone: 'bad' };
    default:
      return { text: 'lost', tone: 'gone' };
  }
}

/// 12 300 → "12.3 k".
export function many(n: number): string {
  const a = Math.abs(n);
  if (a >= 1e9) return `${(n / 1e9).toFixed(2)} G`;
  if (a >= 1e6) return `${(n / 1e6).toFixed(a >= 1e7 ? 1 : 2)} M`;
  if (a >= 1e4) return `${(n / 1e3).toFixed(1)} k`;
  return a >= 100 || Number.isInteger(n) ? n.toFixed(0) : n.toFixed(1);
}

/// Nanoseconds in the unit that reads best.
export function span(ns: number): string {
  if (ns >= 1e9) return `${(ns / 1e9).toFixed(2)} s`;
  if (ns >= 1e6) return `${(ns / 1e6).toFixed(ns >= 1e7 ? 1 : 2)} ms`;
  if (ns >= 1e3) return `${(ns / 1e3).toFixed(ns >= 1e5 ? 0 : 1)} µs`;
  return `${Math.round(ns)} ns`;
}

/// A latency; nothing where none was measured, as of commands.
export function measured(ns: number): string {
  return ns > 0 ? span(ns) : '–';
}

export function clock(wallNs: bigint): string {
  return new Date(Number(wallNs / 1000000n)).toLocaleTimeString([], { hour12: false });
}

/// The order of names: sine2 before sine10.
export const byName = new Intl.Collator('en', { numeric: true }).compare;

export function lastPart(path: string): string {
  return path.slice(path.lastIndexOf('/') + 1);
}

export function componentOf(path: string): string {
  return path.split('/').slice(0, 2).join('/');
}

/// A colour per type: equal types have equal hashes, so equal colours.
const HUES = [199, 152, 32, 280, 340, 88, 224, 12];
export function colourOf(hash: string): string {
  if (!hash) return 'var(--any)';
  const n = Number.parseInt(hash.slice(-6), 16) || 0;
  return `hsl(${HUES[n % HUES.length]} 62% var(--port-light))`;
}

/// 12 345 678 B → "12.3 MB".
export function size(bytes: number): string {
  if (bytes >= 1e9) return `${(bytes / 1e9).toFixed(2)} GB`;
  if (bytes >= 1e6) return `${(bytes / 1e6).toFixed(1)} MB`;
  return bytes >= 1e3 ? `${(bytes / 1e3).toFixed(1)} kB` : `${Math.round(bytes)} B`;
}

/// 75 s → "1:15".
export function lasting(s: number): string {
  const [h, m, rest] = [Math.floor(s / 3600), Math.floor(s / 60) % 60, Math.floor(s) % 60];
  const two = (n: number) => String(n).padStart(2, '0');
  return h ? `${h}:${two(m)}:${two(rest)}` : `${m}:${two(rest)}`;
}

/// "1 output", "2 outputs"; `written`: the number as it is written.
export function count(n: number, one: string, written = String(n)): string {
  return `${written} ${one}${n === 1 ? '' : one.endsWith('s') ? 'es' : 's'}`;
}

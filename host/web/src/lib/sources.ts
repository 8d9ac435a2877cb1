/// The outputs a recording could take, and the processes that could record them.
///
/// Invariant: the rules are those of `trocar record` (host/cli/src/recording/record.rs): which outputs count,
/// how deep a queue is, and which process records.
import { Code, ConnectError } from '@connectrpc/connect';
import { gcm, PATIENCE, said } from './api';
import { matches, mayMean } from './patterns';

export const RECORDER = 'recorder/recorder';
/// Samples that may wait, at most, and bytes of them; frames that may.
const DEEPEST = 4096;
const QUEUE_BYTES = 16 << 20;
const FRAMES = 64;

export interface Source {
  /// process/component/output.
  path: string;
  frames: boolean;
  /// Bytes of a sample.
  size: number;
}

export interface Sources {
  all: Source[];
  /// Processes that offer a recorder.
  recorders: string[];
  /// Components that did not tell their outputs, and why.
  unheard: { path: string; why: string }[];
}

/// Asks each component for its outputs, one after the other.
export async function learnSources(): Promise<Sources> {
  const there = await gcm.list({ brief: true }, PATIENCE);
  const all: Source[] = [];
  const unheard: Sources['unheard'] = [];
  for (const { path } of there.components) {
    const told = await gcm.describe({ path }, PATIENCE).catch((error) => {
      // A component that went away meanwhile is not there to be recorded.
      if (ConnectError.from(error).code !== Code.NotFound) unheard.push({ path, why: said(error) });
    });
    for (const output of told?.ports?.outputs ?? []) {
      const kind = output.type?.kind;
      // An output without a type of its own has nothing to record.
      if (kind?.case === 'plain') all.push({ path: `${path}/${output.name}`, frames: false, size: kind.value.size });
      else if (kind?.case === 'frame') all.push({ path: `${path}/${output.name}`, frames: true, size: 0 });
    }
  }
  return { all, recorders: there.processes.filter((p) => p.classes.includes(RECORDER)).map((p) => p.name), unheard };
}

/// Components that may have outputs that are meant, and told none: a sentence each.
export function unheardOf(patterns: string[], { unheard }: Sources): string[] {
  const meant = unheard.filter(({ path }) => patterns.some((pattern) => mayMean(pattern, path)));
  return meant.map(({ path, why }) => `${path} did not report its outputs: ${why}`);
}

export function chosen(patterns: string[], all: Source[]): Source[] {
  return all.filter((source) => patterns.some((pattern) => matches(pattern, source.path)));
}

export function depthOf({ frames, size }: Source): number {
  return frames ? FRAMES : Math.min(DEEPEST, Math.max(16, Math.floor(QUEUE_BYTES / Math.max(1, size))));
}

/// The process with most of what is recorded; empty = no process offers a recorder.
export function bestProcess({ recorders }: Sources, wanted: Source[]): string {
  const count = (process: string) => wanted.filter((s) => s.path.startsWith(`${process}/`)).length;
  // The last one of equals, as `trocar record` takes it.
  return recorders.reduce((best, process) => (best === '' || count(process) >= count(best) ? process : best), '');
}

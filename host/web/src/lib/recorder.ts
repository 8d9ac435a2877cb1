/// A recorder made for one recording: created, connected, started; taken away where any of that is refused.
///
/// Invariant: same configuration, queues and priority as `trocar record` (host/cli/src/recording/record.rs).
/// Only its directory is the class's default, and nobody holds it: a page that is closed ends no recording.
import { Code, ConnectError } from '@connectrpc/connect';
import { gcm, interact, PATIENCE, said, wrapped } from './api';
import { page } from './page.svelte';
import { matches, nearestTo } from './patterns';
import { bestProcess, chosen, depthOf, learnSources, RECORDER, unheardOf, type Source, type Sources } from './sources';
import { system } from './system.svelte';

/// Above all threads without a priority: the disk's work in the kernel may hold those up for 100 ms.
const PRIORITY = 1;
const BUFFER_MB = 256;
/// All connections together may take this long.
const CONNECTS = { timeoutMs: 30_000 };

export interface Wanted {
  patterns: string[];
  /// A name in the recorder's directory.
  file: string;
  /// s; 0 = until somebody stops it.
  seconds: number;
  video: string;
  /// At most so many samples of each output, Hz; 0 = all.
  maxRateHz: number;
  /// Empty = the process with most of what is recorded.
  process: string;
}

/// Why a pattern means nothing, with the nearest names; empty = it means something.
export function unmatched(pattern: string, all: Source[]): string {
  if (all.some((source) => matches(pattern, source.path))) return '';
  if (all.length === 0) return `“${pattern}” matches no output: there are no outputs yet`;
  return `“${pattern}” matches no output; the nearest names are ${nearestTo(pattern, all.map((s) => s.path)).join(', ')}`;
}

function plan(wanted: Wanted, there: Sources): { process: string; outputs: Source[]; unheard: string[] } {
  if (wanted.patterns.length === 0) throw new Error('no pattern: name what is recorded, such as **');
  for (const pattern of wanted.patterns) {
    const why = unmatched(pattern, there.all);
    if (why) throw new Error([`${why}. Nothing was started.`, ...unheardOf([pattern], there)].join(' '));
  }
  const outputs = chosen(wanted.patterns, there.all);
  const process = wanted.process || bestProcess(there, outputs);
  if (!process) throw new Error(`no process has the class ${RECORDER}: put libtrocar_recorder.so into a plugin directory of one`);
  return { process, outputs, unheard: unheardOf(wanted.patterns, there) };
}

/// Answers the recorder's path. `tell` hears what is being done and to which recorder, `left` which outputs
/// are left out, and why.
export async function makeRecorder(wanted: Wanted, name: string, tell: (doing: string, path?: string) => void, left: (path: string, sentences: string[]) => void): Promise<string> {
  tell('looking at what there is…');
  const { process, outputs, unheard } = plan(wanted, await learnSources());
  let component = `${process}/${name}`;
  for (let n = 2; system.components.has(component); n += 1) component = `${process}/${name}-${n}`;
  tell('making a recorder…', component);
  const config = {
    topics: outputs.map((_, n) => `t${n}`),
    sources: outputs.map((source) => source.path),
    max_rate_hz: outputs.map(() => wanted.maxRateHz),
    video: wanted.video,
    buffer_mb: BUFFER_MB,
  };
  try {
    const { warnings } = await gcm.create({ path: component, class: RECORDER, config, execution: { priority: PRIORITY } }, PATIENCE);
    // Its thread may not have been given what was asked for.
    for (const warning of warnings) page.warn(`${component}: ${warning}`);
  } catch (error) {
    // Without an answer nobody knows whether it was made; a refusal made nothing.
    if (ConnectError.from(error).code === Code.DeadlineExceeded) await undo(component);
    throw error;
  }
  try {
    left(component, [...unheard, ...(await connectAll(component, outputs, tell))]);
    tell('starting…');
    await gcm.start({ paths: [component] }, PATIENCE);
    const json = wrapped({ path: wanted.file, delay: 0, duration: wanted.seconds });
    await interact.invoke({ path: `${component}/ctl/start`, json, deadline: { seconds: 5n } }, PATIENCE);
  } catch (error) {
    const stays = await undo(component);
    if (stays) throw new Error(`${said(error)}; and ${component} is left behind: ${stays}`);
    throw error;
  }
  return component;
}

/// Connects all in one request; where that is refused one by one, so that one output keeps no other from
/// being recorded. Answers what is left out.
async function connectAll(component: string, outputs: Source[], tell: (doing: string) => void): Promise<string[]> {
  const ties = outputs.map((source, n) => ({ client: `${component}/t${n}`, server: source.path, options: { queue: { fifo: depthOf(source), dropOldest: false } } }));
  tell(`connecting ${ties.length}…`);
  // A manager that does not answer is not asked again for each output.
  const told = (error: unknown): string => {
    if (ConnectError.from(error).code === Code.DeadlineExceeded) throw error;
    return said(error);
  };
  const refused = await gcm.apply({ steps: ties.map((value) => ({ step: { case: 'connect' as const, value } })) }, CONNECTS).then(() => '', told);
  const sentences: string[] = [];
  for (const [n, tie] of refused ? ties.entries() : []) {
    tell(`connecting ${n + 1} of ${ties.length}…`);
    await gcm.connect(tie, PATIENCE).catch((error) => sentences.push(`${tie.server}: ${told(error)}`));
  }
  if (sentences.length === ties.length) throw new Error(`nothing can be recorded: ${sentences[0]}`);
  return sentences;
}

/// Takes it away with all its connections; answers why it stays.
async function undo(component: string): Promise<string> {
  try {
    await gcm.remove({ path: component, force: true }, PATIENCE);
    return '';
  } catch (error) {
    return ConnectError.from(error).code === Code.NotFound ? '' : said(error);
  }
}

/// The fate of a process: its state, its last end, and the ways back, Restart and Forget.
///
/// Invariant: the page says since when only of what it saw happen, and tells refusals in the server's words.
import { ProcessState, type Process } from '../gen/trocar/v1/types_pb';
import { gcm, said } from './api';
import { clockNow } from './now.svelte';
import { page } from './page.svelte';
import { system } from './system.svelte';
import { processOf } from './words';

/// A process may take this long to start and to make its components, ms.
const STARTS = 30_000;

/// "was killed by SIGKILL" → "killed by SIGKILL"; empty when no supervisor told.
export function endOf(p: Process): string {
  return p.lastExit.replace(/^was /, '');
}

/// "12 s ago"; empty when it happened before this page looked.
export function sinceOf(name: string): string {
  const at = system.since.get(name);
  if (at === undefined) return '';
  const s = Math.max(0, Math.round((clockNow.ms - at) / 1000));
  if (s < 120) return `${s} s ago`;
  return s < 7200 ? `${Math.floor(s / 60)} min ago` : `${Math.floor(s / 3600)} h ago`;
}

/// The process has ended, or nobody hears it: there may be a way back.
export function isAway(p: Process | undefined): boolean {
  return p?.state === ProcessState.LOST || p?.state === ProcessState.FAILED;
}

/// In few words: "lost 12 s ago: killed by SIGKILL".
export function fateOf(p: Process): string {
  const { text } = processOf(p);
  if (p.state === ProcessState.ATTACHED) return text;
  const since = sinceOf(p.name);
  return [`${text}${since && ` ${since}`}`, endOf(p)].filter(Boolean).join(': ');
}

class Ways {
  /// The process that is to be forgotten, while the page asks.
  forgetting = $state('');
  /// The process that is being started again.
  restarting = $state('');
  /// The server's words on the last try, and the process.
  refusal = $state({ process: '', text: '' });

  async restart(process: string): Promise<void> {
    if (this.restarting) return;
    this.restarting = process;
    await this.#try(process, `Restart ${process}`, () => gcm.restart({ process }, { timeoutMs: STARTS }));
    this.restarting = '';
  }

  async forget(process: string): Promise<void> {
    await this.#try(process, `Forget ${process}`, () => gcm.forget({ process }, { timeoutMs: STARTS }));
  }

  /// A refusal is shown in the process's panel.
  async #try(process: string, what: string, call: () => Promise<object>) {
    this.refusal = { process, text: '' };
    try {
      await call();
      page.tell(`${what}: done`);
    } catch (error) {
      this.refusal = { process, text: said(error) };
    }
  }
}

export const ways = new Ways();

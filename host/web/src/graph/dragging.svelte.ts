/// A connection that is being drawn: which ports fit, and what the server says of the pair under the pointer.
///
/// Invariant: what is shown before the drop is the server's own answer to `validate_only`, never a guess of the page.
import { ConnectError } from '@connectrpc/connect';
import { gcm, said } from '../lib/api';
import { isClient, offers, plainlyWrong, type Port } from '../lib/ports.svelte';

/// Answers are believed this long, ms: the graph moves on.
const FRESH = 2000;

interface Verdict {
  at: number;
  asking: boolean;
  refusal: string;
  plan: string;
}

class Dragging {
  /// Port the drag began at; empty = none.
  from = $state('');
  /// Port under the pointer.
  over = $state('');
  verdict = $state<Verdict | null>(null);
  #known = new Map<string, Verdict>();

  begin(path: string) {
    this.from = path;
    this.over = '';
    this.verdict = null;
    this.#known.clear();
  }

  end() {
    this.from = '';
    this.over = '';
    this.verdict = null;
  }

  /// Client end, then server end.
  ends(a: string, b: string): [string, string] {
    const kind = offers.port(a)?.kind;
    return kind && isClient(kind) ? [a, b] : [b, a];
  }

  /// False only for what cannot be, whatever the server says in detail.
  fits(path: string, port: Port): boolean {
    if (path === this.from) return true;
    const began = offers.port(this.from);
    if (!began) return true;
    return isClient(began.kind) ? plainlyWrong(began, port) === '' : plainlyWrong(port, began) === '';
  }

  /// Shows what the server says of the pair.
  hover(path: string) {
    if (path === this.over) return;
    this.over = path;
    if (path === '' || path === this.from) {
      this.verdict = null;
      return;
    }
    const [client, server] = this.ends(this.from, path);
    const key = `${client} ${server}`;
    const known = this.#known.get(key);
    if (known && (known.asking || performance.now() - known.at < FRESH)) {
      this.verdict = known;
      return;
    }
    this.verdict = { at: performance.now(), asking: true, refusal: '', plan: '' };
    this.#known.set(key, this.verdict);
    void this.#ask(key, client, server);
  }

  async #ask(key: string, client: string, server: string) {
    let verdict: Verdict;
    try {
      const answer = await gcm.connect({ client, server, validateOnly: true }, { timeoutMs: 3000 });
      verdict = { at: performance.now(), asking: false, refusal: '', plan: answer.plan.join('\n') };
    } catch (error) {
      verdict = { at: performance.now(), asking: false, refusal: said(ConnectError.from(error)), plan: '' };
    }
    this.#known.set(key, verdict);
    if (this.from && this.ends(this.from, this.over).join(' ') === key) this.verdict = verdict;
  }
}

export const dragging = new Dragging();

/// A connection that is being drawn: which ports fit, and what the server says of the pair under the pointer.
///
/// Invariant: what is shown before the drop is the server's own answer to `validate_only`, never a guess of the page.
import { isClient, offers, plainlyWrong, type Port } from '../lib/ports.svelte';
import { ends, judge, type Verdict } from '../lib/verdict';

/// Answers are believed this long, ms: the graph moves on.
const FRESH = 2000;

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
    const [client, server] = ends(this.from, path);
    const key = `${client} ${server}`;
    const known = this.#known.get(key);
    if (known && (known.asking || performance.now() - known.at < FRESH)) {
      this.verdict = known;
      return;
    }
    this.verdict = { at: performance.now(), asking: true, refusal: '' };
    this.#known.set(key, this.verdict);
    void this.#ask(key, client, server);
  }

  async #ask(key: string, client: string, server: string) {
    const verdict = await judge(client, server);
    this.#known.set(key, verdict);
    if (this.from && ends(this.from, this.over).join(' ') === key) this.verdict = verdict;
  }
}

export const dragging = new Dragging();

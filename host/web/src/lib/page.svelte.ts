/// What this page itself remembers: what is selected, which panel shows, light or dark, what was told.
import { Code, ConnectError } from '@connectrpc/connect';
import { said } from './api';
import { events } from './events.svelte';

export type Tab = 'overview' | 'interfaces' | 'configure' | 'invoke';
export type Dock = 'plots' | 'video' | 'events' | 'log';

interface Note {
  id: number;
  text: string;
  tone: 'good' | 'warn' | 'bad';
}

/// A path, and why nothing was done there.
interface Left {
  path: string;
  why: string;
}

/// The parts of an answer to a change that are told.
interface Answer {
  warnings?: string[];
  skipped?: Left[];
  failed?: Left[];
}

const query = new URLSearchParams(location.search);
/// A window with room below the graph for a panel or for the dock (App.svelte hides the dock).
const narrow = matchMedia('(max-width: 760px)');

class Page {
  /// Nothing can be changed from this page: its address says so, or the server, which then refuses it, too.
  readonly = query.has('readonly') || document.querySelector('meta[name=viewer]')?.getAttribute('content') === 'read-only';
  /// process/component, "connection:ID" or "process:NAME".
  selected = $state('');
  tab = $state<Tab>('overview');
  /// Command to open in the form.
  command = $state('');
  dock = $state<Dock>('plots');
  docked = $state(false);
  palette = $state(false);
  searching = $state(false);
  dark = $state(stored('theme', matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light') === 'dark');
  notes = $state<Note[]>([]);
  /// Outputs shown as pictures.
  pictures = $state.raw<string[]>([]);
  /// Brings a component into view.
  reveal: (path: string) => void = () => {};
  #count = 0;

  theme(dark: boolean) {
    this.dark = dark;
    try {
      localStorage.setItem('theme', dark ? 'dark' : 'light');
    } catch {
      // It is then remembered as long as the page is open.
    }
  }

  tell(text: string, bad = false) {
    this.#note(text, bad ? 'bad' : 'good');
  }

  /// It was done, but not quite as asked.
  warn(text: string) {
    this.#note(text, 'warn');
  }

  #note(text: string, tone: Note['tone']) {
    const id = ++this.#count;
    this.notes = [...this.notes.slice(-4), { id, text, tone }];
    setTimeout(() => this.dismiss(id), tone === 'good' ? 4000 : 12000);
  }

  dismiss(id: number) {
    this.notes = this.notes.filter((n) => n.id !== id);
  }

  /// Does what was asked and tells what became of it.
  async ask(what: string, call: () => Promise<Answer>): Promise<boolean> {
    try {
      const answer = await call();
      for (const s of answer.skipped ?? []) this.tell(`${what}: ${s.path} was left alone: ${s.why}`, true);
      for (const f of answer.failed ?? []) this.tell(`${what}: ${f.path}: ${f.why}`, true);
      // A failure is a warning, too, for programs that do not look there.
      const failed = new Set(answer.failed?.map((f) => `${f.path}: ${f.why}`));
      for (const w of answer.warnings ?? []) if (!failed.has(w)) this.warn(`${what}: ${w}`);
      if (!answer.skipped?.length && !failed.size) this.tell(`${what}: done`);
      return true;
    } catch (error) {
      const code = Code[ConnectError.from(error).code];
      this.tell(`${what}: ${said(error)} (${code})`, true);
      return false;
    }
  }

  open(path: string, tab: Tab, command = '') {
    this.selected = path;
    this.tab = tab;
    this.command = command;
  }

  /// Whether that is what stands below the graph now.
  sees(what: Dock): boolean {
    return this.docked && this.dock === what && !(narrow.matches && (this.selected || this.palette));
  }

  /// Shows that below the graph; in a narrow window a panel makes room for it.
  show(what: Dock) {
    this.docked = true;
    this.dock = what;
    if (!narrow.matches) return;
    this.selected = '';
    this.palette = false;
  }

  /// Shows it, or takes it away.
  toggle(what: Dock) {
    if (this.sees(what)) this.docked = false;
    else this.show(what);
  }

  picture(path: string) {
    this.show('video');
    if (!this.pictures.includes(path)) this.pictures = [...this.pictures, path];
  }

  event(path: string) {
    this.show('events');
    events.follow(path);
  }
}

function stored(key: string, otherwise: string): string {
  try {
    return localStorage.getItem(key) ?? otherwise;
  } catch {
    return otherwise;
  }
}

export const page = new Page();

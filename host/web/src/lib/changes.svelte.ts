/// Changes made from this page, and the steps that take them back and do them again.
///
/// Invariant: nothing is taken back but changes made here, by requests like any other: obstacles are told.
/// Nothing that runs is taken away, and what ran before it was removed comes back at rest.
import type { MessageInitShape } from '@bufbuild/protobuf';
import { Code, ConnectError } from '@connectrpc/connect';
import type { StepSchema } from '../gen/trocar/v1/gcm_pb';
import { ComponentState, type Connection, type ExecutionSchema } from '../gen/trocar/v1/types_pb';
import { gcm, PATIENCE } from './api';
import { page } from './page.svelte';
import type { Values } from './schema';
import { system } from './system.svelte';
import { componentOf } from './words';

type Step = NonNullable<NonNullable<MessageInitShape<typeof StepSchema>['step']>>;
type Asked = MessageInitShape<typeof ExecutionSchema>;

interface Change {
  what: string;
  back: Step[];
  again: Step[];
  /// The component that one of them takes away: not while it runs.
  takes?: string;
}

/// So many are remembered.
const MOST = 100;

class Changes {
  past = $state.raw<Change[]>([]);
  /// Taken back, the last one first.
  future = $state.raw<Change[]>([]);
  /// Waits until all that a hand has moved is noted here.
  settled: () => Promise<unknown> = () => Promise.resolve();
  /// Ends with the one that is under way: what is asked meanwhile comes after it.
  #turn: Promise<void> = Promise.resolve();

  /// The change is the last one that can be taken back; those taken back before cannot be done again.
  #done(change: Change) {
    this.past = [...this.past, change].slice(-MOST);
    this.future = [];
  }

  undo(): Promise<void> {
    return (this.#turn = this.#turn.catch(() => undefined).then(() => this.#undo()));
  }

  redo(): Promise<void> {
    return (this.#turn = this.#turn.catch(() => undefined).then(() => this.#redo()));
  }

  async #undo() {
    await this.settled();
    const last = this.past.at(-1);
    const came = last && (await this.#carry(`Undo ${last.what}`, last.back, last.takes));
    if (!came) return;
    this.past = this.past.filter((c) => c !== last);
    if (came === 'done') this.future = [...this.future, last];
  }

  async #redo() {
    await this.settled();
    const next = this.future.at(-1);
    const came = next && (await this.#carry(`Redo ${next.what}`, next.again, next.takes));
    if (!came) return;
    this.future = this.future.filter((c) => c !== next);
    if (came === 'done') this.past = [...this.past, next];
  }

  /// 'gone': what it is about is not there any more, so it never will be done, and older changes may be.
  async #carry(what: string, steps: Step[], takes = ''): Promise<'done' | 'gone' | undefined> {
    if (system.components.get(takes)?.state === ComponentState.ACTIVE) {
      page.tell(`${what}: ${takes} is ACTIVE: stop it first`, true);
      return undefined;
    }
    let gone = false;
    const done = await page.ask(what, async () => {
      try {
        return await gcm.apply({ steps: steps.map((step) => ({ step })) }, PATIENCE);
      } catch (error) {
        gone = ConnectError.from(error).code === Code.NotFound;
        throw error;
      }
    });
    return done ? 'done' : gone ? 'gone' : undefined;
  }

  async connect(client: string, server: string): Promise<boolean> {
    const done = await page.ask(`Connect ${client} to ${server}`, () => gcm.connect({ client, server }, PATIENCE));
    if (done) this.#done({ what: `Connect ${client} to ${server}`, back: [cut(client, server)], again: [{ case: 'connect', value: { client, server } }] });
    return done;
  }

  async disconnect(id: string): Promise<boolean> {
    const was = system.connections.get(id);
    const done = await page.ask(was ? `Disconnect ${was.client} from ${was.server}` : 'Disconnect', () => gcm.disconnect({ id: BigInt(id) }, PATIENCE));
    if (done && was) this.#done({ what: `Disconnect ${was.client} from ${was.server}`, back: [tie(was)], again: [cut(was.client, was.server)] });
    return done;
  }

  async remove(path: string): Promise<boolean> {
    const was = system.components.get(path);
    const ties = [...system.connections.values()].filter((c) => [c.client, c.server].some((end) => componentOf(end) === path));
    const done = await page.ask(`Remove ${path}`, () => gcm.remove({ path, force: true }, PATIENCE));
    if (done && was) {
      // An incomplete configuration is not taken when it is given.
      const config = was.state === ComponentState.CREATED ? undefined : was.config;
      const made: Step = { case: 'create', value: { ...lives(path), class: was.class, config, execution: was.execution } };
      // A guest ties itself to what it asks.
      const own = ties.filter((c) => !system.processes.get(c.client.split('/')[0])?.guest);
      this.#done({ what: `Remove ${path}`, back: [made, ...own.map(tie)], again: [{ case: 'remove', value: { path, force: true } }], takes: path });
    }
    return done;
  }

  /// Notes a component that was just made from a form.
  created(path: string, cls: string, config: Values | undefined, execution: Asked | undefined) {
    const made: Step = { case: 'create', value: { path, class: cls, config: config as never, execution } };
    this.#done({ what: `Create ${path}`, back: [{ case: 'remove', value: { path } }], again: [made], takes: path });
  }

  /// Notes one that was just configured: its changed parts as they were sent, and as they were before.
  configured(path: string, now: Settings, before: Settings) {
    this.#done({ what: `Configure ${path}`, back: [configure(path, before)], again: [configure(path, now)] });
  }
}

interface Settings {
  config?: Values;
  execution?: Asked;
}

function configure(path: string, { config, execution }: Settings): Step {
  return { case: 'configure', value: { path, config: config as never, execution } };
}

function cut(client: string, server: string): Step {
  return { case: 'disconnect', value: { client, server } };
}

/// As it was, but in nobody's place: what has been connected there since stays.
function tie({ client, server, options }: Connection): Step {
  return { case: 'connect', value: { client, server, options: options && { ...options, replace: false } } };
}

/// The path and isolation that make one which lives here: in a process of its own it is written otherwise.
function lives(path: string) {
  const [process, name] = path.split('/');
  const home = process.endsWith(`.${name}`) ? process.slice(0, -name.length - 1) : '';
  return system.processes.has(home) ? { path: `${home}/${name}`, isolation: 'process' } : { path };
}

export const changes = new Changes();

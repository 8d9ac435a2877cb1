/// Places of boxes and ways of wires: ELK in a worker, each process by itself, then all among each other.
///
/// Invariant: the page is never held up by it: an answer may come late, and is then followed by one for what is there by now.
import ELK, { type ElkEdgeSection, type ElkExtendedEdge, type ElkNode } from 'elkjs/lib/elk-api';
import workerUrl from 'elkjs/lib/elk-worker.min.js?url';
import type { Connection } from '../gen/trocar/v1/types_pb';
import type { Card } from './card';
import { byName, componentOf } from './words';

const PAD = { top: 46, side: 24 };
/// A box without components.
export const LEAST = { width: 260, height: 90 };
/// Between two processes, px.
const BETWEEN = 110;
/// Above and below what a process has beside its connected components, px.
const APART = 30;
/// More components than this are laid out in one way, without a choice.
const MANY = 80;

export interface Placed {
  x: number;
  y: number;
}

export interface Box extends Placed {
  width: number;
  height: number;
}

export interface Layout {
  /// Within their processes.
  components: Map<string, Placed>;
  processes: Map<string, Box>;
  /// From the server's port to the client's, by a connection's id.
  ways: Map<string, Placed[]>;
}

/// A room that the picture shall fill, px.
export interface Room {
  width: number;
  height: number;
}

/// A density, and whether a long row goes on below its begin.
interface Manner {
  gap: number;
  wrapped: boolean;
}

let elk: InstanceType<typeof ELK> | undefined;

/// The layout that is seen largest in the room, at full size at most; the airiest of those.
/// Ask for the next one when this has answered.
export async function layout(processes: string[], cards: Map<string, Card>, connections: Connection[], room: Room): Promise<Layout> {
  elk ??= new ELK({ workerUrl });
  const manners: Manner[] = [{ gap: 110, wrapped: false }, { gap: 76, wrapped: false }];
  if (room.width < room.height) manners.push({ gap: 60, wrapped: true });
  let best: { layout: Layout; zoom: number } | undefined;
  for (const manner of cards.size > MANY ? manners.slice(1, 2) : manners) {
    const made = await arranged(processes, cards, connections, room, manner);
    const zoom = zoomOf(made, room);
    if (!best || zoom > best.zoom * 1.02) best = { layout: made, zoom };
    if (best.zoom === 1) break;
  }
  return best!.layout;
}

/// The zoom at which all of it fits.
function zoomOf(made: Layout, room: Room): number {
  const boxes = [...made.processes.values()];
  const [width, height] = [Math.max(...boxes.map((b) => b.x + b.width), 1), Math.max(...boxes.map((b) => b.y + b.height), 1)];
  return Math.min(1, room.width / width, room.height / height);
}

async function arranged(processes: string[], cards: Map<string, Card>, connections: Connection[], room: Room, manner: Manner): Promise<Layout> {
  const home = (path: string) => path.slice(0, path.indexOf('/'));
  const known = connections.filter((c) => cards.has(componentOf(c.server)) && cards.has(componentOf(c.client)));
  const isInside = (c: Connection) => home(c.server) === home(c.client);
  const across = known.filter((c) => !isInside(c));
  const insides = new Map<string, Inside>();
  for (const name of processes) {
    const own = [...cards].filter(([path]) => home(path) === name).sort(([a], [b]) => byName(a, b));
    const exits = [
      ...across.filter((c) => home(c.server) === name).map((c) => ({ id: String(c.id), port: c.server, out: true })),
      ...across.filter((c) => home(c.client) === name).map((c) => ({ id: String(c.id), port: c.client, out: false })),
    ];
    insides.set(name, await inside(new Map(own), known.filter((c) => isInside(c) && home(c.server) === name), exits, room, manner));
  }
  const done = await elk!.layout(among(insides, across, home, room));
  const made: Layout = { components: new Map(), processes: new Map(), ways: new Map() };
  for (const p of done.children ?? []) {
    const name = p.id.slice('process:'.length);
    const [x, y] = [p.x ?? 0, p.y ?? 0];
    const within = insides.get(name)!;
    made.processes.set(name, { x, y, width: within.width, height: within.height });
    for (const [path, place] of within.components) made.components.set(path, place);
    for (const [id, way] of within.ways) made.ways.set(id, way.map((at) => ({ x: at.x + x, y: at.y + y })));
  }
  const shifted = (name: string, way: Placed[]) => {
    const box = made.processes.get(name)!;
    return way.map((at) => ({ x: at.x + box.x, y: at.y + box.y }));
  };
  for (const edge of done.edges ?? []) {
    const c = across.find((c) => String(c.id) === edge.id)!;
    const out = shifted(home(c.server), insides.get(home(c.server))!.exits.get(`out:${edge.id}`) ?? []);
    const into = shifted(home(c.client), insides.get(home(c.client))!.exits.get(`in:${edge.id}`) ?? []);
    made.ways.set(edge.id, [...out, ...wayOf(edge), ...into]);
  }
  return made;
}

/// The inside of a process.
interface Inside {
  width: number;
  height: number;
  components: Map<string, Placed>;
  ways: Map<string, Placed[]>;
  /// Ways between a port and the border of the process, by `out:ID` and `in:ID`.
  exits: Map<string, Placed[]>;
}

interface Exit {
  id: string;
  port: string;
  /// Leaves the process to the right; others come in from the left.
  out: boolean;
}

/// Components tied to other processes stand above, from border to border; below them the others, packed.
async function inside(cards: Map<string, Card>, connections: Connection[], exits: Exit[], room: Room, manner: Manner): Promise<Inside> {
  const tied = reached(exits.map((e) => componentOf(e.port)), connections);
  const blocks: ElkNode[] = [];
  for (const isTied of [true, false]) {
    const part = new Map([...cards].filter(([path]) => tied.has(path) === isTied));
    const ties = connections.filter((c) => part.has(componentOf(c.server)));
    if (part.size) blocks.push(await elk!.layout(block(part, ties, isTied ? exits : [], room, manner)));
  }
  const all: Inside = { width: LEAST.width, height: LEAST.height, components: new Map(), ways: new Map(), exits: new Map() };
  for (const b of blocks) all.width = Math.max(all.width, (b.width ?? 0) + 2 * PAD.side);
  let top = PAD.top;
  for (const b of blocks) {
    const at = (p: Placed) => ({ x: p.x + PAD.side, y: p.y + top });
    for (const c of b.children ?? []) if (cards.has(c.id)) all.components.set(c.id, at({ x: c.x ?? 0, y: c.y ?? 0 }));
    for (const e of b.edges ?? []) {
      const way = wayOf(e).map(at);
      if (e.id.startsWith('out:')) all.exits.set(e.id, [...way, { x: all.width, y: way.at(-1)!.y }]);
      else if (e.id.startsWith('in:')) all.exits.set(e.id, [{ x: 0, y: way[0]!.y }, ...way]);
      else all.ways.set(e.id, way);
    }
    top += (b.height ?? 0) + APART;
  }
  all.height = Math.max(all.height, top - APART + PAD.side);
  return all;
}

/// These components, and all that hang together with them.
function reached(from: string[], connections: Connection[]): Set<string> {
  const near = new Map<string, string[]>();
  for (const c of connections) {
    const [a, b] = [componentOf(c.server), componentOf(c.client)];
    near.set(a, [...(near.get(a) ?? []), b]);
    near.set(b, [...(near.get(b) ?? []), a]);
  }
  const seen = new Set(from);
  for (const path of seen) for (const next of near.get(path) ?? []) seen.add(next);
  return seen;
}

/// The ratio given to ELK, so that rows of boxes fill the room: their width is this times the root of the area
/// of the boxes. Gaps take 0.6 of that area again.
const packed = (room: Room): number => Math.sqrt((1.6 * room.width) / room.height);

/// Components of one process and what ties them. At its sides two thin nodes stand for the border.
function block(cards: Map<string, Card>, connections: Connection[], exits: Exit[], room: Room, manner: Manner): ElkNode {
  const end = (path: string) => (cards.get(componentOf(path))!.spots.some((s) => path.endsWith(`/${s.port.name}`)) ? path : componentOf(path));
  const border = (out: boolean): ElkNode[] => {
    const here = exits.filter((e) => e.out === out);
    if (!here.length) return [];
    const ports = here.map((e) => ({ id: `border:${e.out}:${e.id}`, width: 0, height: 0, layoutOptions: { 'elk.port.side': out ? 'WEST' : 'EAST' } }));
    const layoutOptions = { 'elk.portConstraints': 'FIXED_SIDE', 'elk.layered.layering.layerConstraint': out ? 'LAST_SEPARATE' : 'FIRST_SEPARATE' };
    return [{ id: `border:${out}`, width: 1, height: here.length * 16, ports, layoutOptions }];
  };
  return {
    id: 'block',
    layoutOptions: {
      ...layered(manner.gap),
      'elk.spacing.nodeNode': '26',
      'elk.spacing.componentComponent': '30',
      'elk.separateConnectedComponents': String(exits.length === 0),
      'elk.aspectRatio': String(manner.wrapped ? room.width / room.height : packed(room)),
      ...(manner.wrapped ? { 'elk.layered.wrapping.strategy': 'MULTI_EDGE' } : {}),
    },
    children: [
      ...[...cards].map(([path, card]) => ({
        id: path,
        width: card.width,
        height: card.height,
        layoutOptions: { 'elk.portConstraints': 'FIXED_POS' },
        ports: card.spots.map((s) => ({ id: `${path}/${s.port.name}`, x: s.left ? 0 : card.width, y: s.y, width: 0, height: 0, layoutOptions: { 'elk.port.side': s.left ? 'WEST' : 'EAST' } })),
      })),
      ...border(true),
      ...border(false),
    ],
    edges: [
      ...connections.map((c) => ({ id: String(c.id), sources: [end(c.server)], targets: [end(c.client)] })),
      ...exits.map((e) => ({ id: `${e.out ? 'out' : 'in'}:${e.id}`, sources: [e.out ? end(e.port) : `border:false:${e.id}`], targets: [e.out ? `border:true:${e.id}` : end(e.port)] })),
    ],
  };
}

/// The processes, whose wires leave and enter where they come out inside.
function among(insides: Map<string, Inside>, across: Connection[], home: (path: string) => string, room: Room): ElkNode {
  return {
    id: 'root',
    layoutOptions: { ...layered(BETWEEN), 'elk.spacing.nodeNode': '40', 'elk.separateConnectedComponents': 'true', 'elk.aspectRatio': String(room.width / room.height) },
    children: [...insides].map(([name, within]) => ({
      id: `process:${name}`,
      width: within.width,
      height: within.height,
      layoutOptions: { 'elk.portConstraints': 'FIXED_POS' },
      ports: [...within.exits].map(([id, way]) => {
        const out = id.startsWith('out:');
        const at = out ? way.at(-1)! : way[0]!;
        return { id: `process:${name}:${id}`, x: at.x, y: at.y, width: 0, height: 0, layoutOptions: { 'elk.port.side': out ? 'EAST' : 'WEST' } };
      }),
    })),
    edges: across.map((c) => ({ id: String(c.id), sources: [`process:${home(c.server)}:out:${c.id}`], targets: [`process:${home(c.client)}:in:${c.id}`] })),
  };
}

function layered(gap: number): Record<string, string> {
  return {
    'elk.algorithm': 'layered',
    'elk.direction': 'RIGHT',
    'elk.edgeRouting': 'ORTHOGONAL',
    'elk.layered.nodePlacement.strategy': 'NETWORK_SIMPLEX',
    'elk.layered.spacing.nodeNodeBetweenLayers': String(gap),
    'elk.spacing.edgeEdge': '18',
    'elk.spacing.edgeNode': '16',
    'elk.layered.spacing.edgeNodeBetweenLayers': '18',
    'elk.layered.spacing.edgeEdgeBetweenLayers': '9',
  };
}

function wayOf(edge: ElkExtendedEdge): Placed[] {
  return (edge.sections ?? []).flatMap((s: ElkEdgeSection) => [s.startPoint, ...(s.bendPoints ?? []), s.endPoint]).map(({ x, y }) => ({ x, y }));
}

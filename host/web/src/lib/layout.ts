/// Where boxes stand: ELK in a worker, each process by itself and then the processes among each other.
///
/// Invariant: the page is never held up by it: an answer may come late, and is then followed by one for what is there by now.
import ELK, { type ElkNode } from 'elkjs/lib/elk-api';
import workerUrl from 'elkjs/lib/elk-worker.min.js?url';
import type { Connection } from '../gen/trocar/v1/types_pb';
import { isClient, type Port } from './ports.svelte';

export const WIDTH = 236;
export const HEAD = 48;
export const ROW = 19;
export const FOOT = 22;
const PAD = { top: 46, side: 22 };

export interface Box {
  path: string;
  ports: Port[];
}

export interface Placed {
  x: number;
  y: number;
}

export interface Layout {
  components: Map<string, Placed>;
  processes: Map<string, Placed & { width: number; height: number }>;
}

let elk: InstanceType<typeof ELK> | undefined;

export function heightOf(ports: Port[]): number {
  const left = ports.filter((p) => isClient(p.kind)).length;
  return HEAD + Math.max(left, ports.length - left, 1) * ROW + FOOT + 8;
}

/// Whoever asks, asks again only when this has answered.
export async function layout(processes: string[], boxes: Box[], connections: Connection[]): Promise<Layout> {
  elk ??= new ELK({ workerUrl });
  const home = (path: string) => path.slice(0, path.indexOf('/'));
  const owner = (end: string) => end.split('/').slice(0, 2).join('/');
  const there = new Map(boxes.map((b) => [b.path, b]));
  const inside = new Map<string, { id: string; sources: string[]; targets: string[] }[]>();
  const between: { id: string; sources: string[]; targets: string[] }[] = [];
  for (const c of connections) {
    const [from, to] = [owner(c.server), owner(c.client)];
    if (!there.has(from) || !there.has(to)) continue;
    if (home(from) === home(to)) {
      const known = (p: string) => there.get(owner(p))!.ports.some((q) => `${owner(p)}/${q.name}` === p);
      const edge = { id: String(c.id), sources: [known(c.server) ? c.server : from], targets: [known(c.client) ? c.client : to] };
      inside.set(home(from), [...(inside.get(home(from)) ?? []), edge]);
    } else {
      between.push({ id: String(c.id), sources: [`process:${home(from)}`], targets: [`process:${home(to)}`] });
    }
  }
  const graph: ElkNode = {
    id: 'root',
    layoutOptions: {
      'elk.algorithm': 'layered',
      'elk.direction': 'RIGHT',
      'elk.spacing.nodeNode': '40',
      'elk.layered.spacing.nodeNodeBetweenLayers': '90',
      'elk.separateConnectedComponents': 'true',
      'elk.aspectRatio': '1.6',
    },
    children: processes.map((name) => ({
      id: `process:${name}`,
      layoutOptions: {
        'elk.algorithm': 'layered',
        'elk.direction': 'RIGHT',
        'elk.padding': `[top=${PAD.top},left=${PAD.side},bottom=${PAD.side},right=${PAD.side}]`,
        'elk.spacing.nodeNode': '26',
        'elk.layered.spacing.nodeNodeBetweenLayers': '130',
        'elk.separateConnectedComponents': 'true',
        'elk.spacing.componentComponent': '30',
        'elk.aspectRatio': '1.7',
        'elk.nodeSize.constraints': 'MINIMUM_SIZE',
        'elk.nodeSize.minimum': '(200, 90)',
      },
      edges: inside.get(name) ?? [],
      children: boxes
        .filter((b) => home(b.path) === name)
        .map((b) => ({
          id: b.path,
          width: WIDTH,
          height: heightOf(b.ports),
          layoutOptions: { 'elk.portConstraints': 'FIXED_POS' },
          ports: [true, false].flatMap((left) =>
            b.ports
              .filter((p) => isClient(p.kind) === left)
              .map((p, i) => ({
                id: `${b.path}/${p.name}`,
                x: left ? 0 : WIDTH,
                y: HEAD + i * ROW + ROW / 2,
                width: 0,
                height: 0,
                layoutOptions: { 'elk.port.side': left ? 'WEST' : 'EAST' },
              })),
          ),
        })),
    })),
    edges: between,
  };
  const done = await elk.layout(graph);
  const result: Layout = { components: new Map(), processes: new Map() };
  for (const p of done.children ?? []) {
    result.processes.set(p.id.slice('process:'.length), { x: p.x ?? 0, y: p.y ?? 0, width: p.width ?? 200, height: p.height ?? 90 });
    for (const c of p.children ?? []) result.components.set(c.id, { x: c.x ?? 0, y: c.y ?? 0 });
  }
  return result;
}

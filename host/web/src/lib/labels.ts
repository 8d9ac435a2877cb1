/// Places of the figures of all wires, and how much each of them says.
///
/// Invariant: no label covers a card, a port or another label. One without room says less, the latency goes
/// first; one that still has none is left out, except where it warns.
import type { Box, Placed } from './layout';
import { wide } from './text';

/// Words of a label.
export interface Words {
  rate: string;
  /// Empty: no latency is measured.
  p99: string;
  /// Empty: nothing was lost.
  loss: string;
  /// It is shown in any case.
  warns: boolean;
}

/// A form of a label: what of its words it says, in a row or in rows below each other, and its size, px.
export interface Form {
  stacked: boolean;
  p99: boolean;
  loss: 'number' | 'word' | '';
  width: number;
  height: number;
}

export interface Wanted {
  /// The line of the wire.
  way: Placed[];
  forms: Form[];
  /// Other wires leave the same output.
  shared: boolean;
  warns: boolean;
}

/// The middle of a label.
export interface Spot extends Placed {
  form: Form;
}

/// Distance by which ports stand out of a card, px.
const PORT = 5.5;
/// Between two labels, px.
const APART = 2;
/// Letters of a label, px, before they grow from afar.
const SIZE = 11;
/// Rates and latencies have the room of these, so that a label stands still while its digits change.
const [RATE, LATENCY] = ['30.0/s', 'p99 888.8 ms'];
/// Beside the words, and between them, px.
const [SIDE, GAP] = [4, 6];
/// Heights of one, two and three rows, px.
const ROWS = [15, 28, 41];

/// The forms of a label with these words, the fullest first. `letters`: how much larger than usual; `short`:
/// only a rate has room.
export function formsOf({ rate, p99, loss }: Words, letters: number, short: boolean): Form[] {
  const forms: Form[] = [];
  const add = (stacked: boolean, latency: boolean, lost: Form['loss']) => {
    const parts = [rate ? Math.max(wide(RATE, true), wide(rate, true)) : 0, latency ? Math.max(wide(LATENCY), wide(p99)) : 0, lost ? wide(lost === 'word' ? 'dropped' : loss) : 0]
      .filter((w) => w > 0).map((w) => w * SIZE);
    const width = SIDE + (stacked ? Math.max(...parts) : parts.reduce((sum, w) => sum + w + GAP, -GAP));
    forms.push({ stacked, p99: latency, loss: lost, width: width * letters, height: ROWS[stacked ? parts.length - 1 : 0]! * letters });
  };
  if (!short) {
    const lost = loss ? 'number' : '';
    if (p99) for (const stacked of [false, true]) add(stacked, true, lost);
    if (loss) for (const stacked of [false, true]) add(stacked, false, 'number');
    if (loss) add(true, false, 'word');
  }
  add(false, false, '');
  return forms;
}

/// A place for each label that has one, by the id of its wire: short wires, which have few places, choose
/// first.
export function placed(wires: Iterable<[string, Wanted]>, cards: Box[]): Map<string, Spot> {
  const taken = cards.map((c) => ({ x: c.x - PORT, y: c.y, width: c.width + 2 * PORT, height: c.height }));
  const spots = new Map<string, Spot>();
  const all = [...wires].map(([id, wanted]) => ({ id, wanted, long: lengthOf(wanted.way) }));
  all.sort((a, b) => a.long - b.long || Number(a.id) - Number(b.id));
  for (const { id, wanted } of all) {
    const at = spot(wanted, taken);
    if (!at) continue;
    spots.set(id, at);
    const { width, height } = at.form;
    taken.push({ x: at.x - width / 2 - APART, y: at.y - height / 2 - APART, width: width + 2 * APART, height: height + 2 * APART });
  }
  return spots;
}

/// The first form that has a place on the way; one that warns stands where it covers least, if none has one.
function spot({ way, forms, shared, warns }: Wanted, taken: Box[]): Spot | undefined {
  const places = along(way, shared);
  for (const form of forms) {
    const at = places.find((p) => covered(p, form, taken) === 0);
    if (at) return { ...at, form };
  }
  const form = forms.at(-1);
  if (!warns || !form) return undefined;
  const [least] = places.map((at) => ({ at, covers: covered(at, form, taken) })).sort((a, b) => a.covers - b.covers);
  return least && { ...least.at, form };
}

function lengthOf(way: Placed[]): number {
  return way.slice(1).reduce((sum, b, i) => sum + Math.hypot(b.x - way[i]!.x, b.y - way[i]!.y), 0);
}

/// Places on a way: the middles of its parts, the longest first, and then others.
function along(way: Placed[], shared: boolean): Placed[] {
  const parts = way.slice(1).map((b, i) => ({ a: way[i]!, b, long: Math.hypot(b.x - way[i]!.x, b.y - way[i]!.y) }));
  // The part that wires of one output have in common is the first.
  const own = shared && parts.length > 2 ? parts.slice(1) : parts;
  own.sort((p, q) => q.long - p.long);
  return [0.5, 0.4, 0.6, 0.3, 0.7, 0.2, 0.8, 0.1, 0.9].flatMap((t) => own.map(({ a, b }) => ({ x: a.x + (b.x - a.x) * t, y: a.y + (b.y - a.y) * t })));
}

/// The part of what is there already that a label at this place would cover, px².
function covered(at: Placed, { width, height }: Form, taken: Box[]): number {
  const [left, right, top, bottom] = [at.x - width / 2, at.x + width / 2, at.y - height / 2, at.y + height / 2];
  let sum = 0;
  for (const c of taken) {
    const w = Math.min(right, c.x + c.width) - Math.max(left, c.x);
    const h = Math.min(bottom, c.y + c.height) - Math.max(top, c.y);
    if (w > 0 && h > 0) sum += w * h;
  }
  return sum;
}

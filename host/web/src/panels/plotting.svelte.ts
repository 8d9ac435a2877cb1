/// A plot on its canvas: uPlot fed with the curves, its axes and cursor.
///
/// Invariant: only changes are drawn, into arrays that are used again; all plots show one cursor.
import uPlot from 'uplot';
import { gestures } from './gestures';
import { look } from '../lib/palette';
import { plots, type Plot, type Span } from '../lib/plots.svelte';
import { ticks, unitOf, type Scale, type Ticks } from '../lib/si';
import { named, type Curve } from '../lib/signals.svelte';
import { Joined } from '../lib/joined';

/// Least size, px.
const LEAST = { width: 120, height: 80 };
/// Room above the axes for their units, and where there are none, px.
const ABOVE = 18;
const NONE = 8;
/// Ticks of the time are kept behind those of left and right.
const BELOW = 2;
/// A mark this near to a click is taken away, px.
const NEAR = 8;

/// The figures of a curve in the legend; undefined: there is none.
export interface Read {
  latest?: number;
  cursor?: number;
  mark?: number;
  points: number;
  kept: number;
  gaps: number;
  skipped: number;
  /// All of its points are of times that are not seen.
  isAway?: boolean;
  /// That of its axis.
  scale?: Scale;
}

/// A drawing that is renewed, and when it last was, ms of the page.
export interface Drawn {
  at: number;
  draw: () => void;
}

export class Plotting {
  read = $state.raw<Read[]>([]);
  /// Left, right and below.
  axes = $state.raw<Ticks[]>([]);
  u: uPlot | undefined;
  #joined = new Joined();
  #span: Span = { from: 0, to: 1 };
  #base = 0;
  #drawn = '';
  #told = '';
  /// The pointer is over this one, and moves the cursor of all.
  #hovers = false;
  #ticks: Ticks[] = [];
  /// The mark before the last click.
  #marked: number | null = null;

  constructor(
    private plot: Plot,
    private box: HTMLElement,
  ) {}

  /// Anew: for other curves, or another theme.
  make(dark: boolean) {
    this.u?.destroy();
    this.#drawn = '';
    this.#ticks = [];
    const { plot, box } = this;
    const colour = (name: string) => getComputedStyle(box).getPropertyValue(name).trim();
    const axis = { stroke: colour('--soft'), grid: { stroke: colour('--faintline'), width: 1 }, ticks: { show: false }, font: '11px system-ui', labelFont: '11px system-ui', gap: 4 };
    const sides = plot.units.map((_, side) => {
      const first = plot.curves.find((c) => plot.side(c) === side)!.signal;
      const values = (_: uPlot, at: number[]) => {
        this.#ticks[side] = first.names ? { texts: at.map((n) => named(first, n)), unit: '', scale: { factor: 1, unit: '' } } : ticks(at, first.unit);
        return this.#ticks[side].texts;
      };
      return { ...axis, scale: `y${side}`, side: side ? 1 : 3, grid: { ...axis.grid, show: side === 0 }, space: 24, size: widest, values, ...(first.names ? { incrs: [1, 2, 5, 10, 20, 50, 100] } : {}) } as uPlot.Axis;
    });
    const above = plot.curves.some((c) => !c.signal.names && unitOf(c.signal.unit)) ? ABOVE : NONE;
    const range = (side: number) => (_: uPlot, low: number | null, high: number | null): [number, number] => plot.held[side] ?? fit(low, high);
    this.u = new uPlot(
      {
        ...this.#size(),
        legend: { show: false },
        cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false, dist: 5 }, bind: { dblclick: () => () => (this.#returns(), null) } },
        scales: {
          x: { time: false, range: () => [this.#span.from - this.#base, this.#span.to - this.#base] },
          ...Object.fromEntries(sides.map((_, side) => [`y${side}`, { range: range(side) }])),
        },
        axes: [{ ...axis, size: 22, space: 60, values: (_, at) => (this.#ticks[BELOW] = ticks(at, 's')).texts.map((t) => `${t} ${this.#ticks[BELOW]!.unit}`) }, ...sides],
        series: [{}, ...plot.curves.map((c) => this.#series(c, dark))],
        padding: [above, sides.length > 1 ? 0 : 20, 0, 0],
        hooks: {
          draw: [(u) => this.#onto(u, colour('--soft'), colour('--accent'))],
          setSelect: [(u) => this.#selected(u)],
        },
      },
      [[], ...plot.curves.map(() => [])] as unknown as uPlot.AlignedData,
      box,
    );
    const { over } = this.u;
    // uPlot moves its cursor also when others do.
    over.addEventListener('mousemove', (e) => {
      this.#hovers = true;
      plots.cursor = this.#timeAt(e.offsetX);
    });
    over.addEventListener('mouseleave', () => {
      if (this.#hovers) plots.cursor = null;
      this.#hovers = false;
    });
    over.addEventListener('click', (e) => e.detail < 2 && this.marks(e.offsetX));
    gestures(over, plot);
  }

  #size() {
    return { width: Math.max(LEAST.width, this.box.clientWidth), height: Math.max(LEAST.height, this.box.clientHeight) };
  }

  resize() {
    const size = this.#size();
    if (this.u && (this.u.width !== size.width || this.u.height !== size.height)) this.u.setSize(size);
  }

  #series(curve: Curve, dark: boolean): uPlot.Series {
    const { colour, dash } = look(this.plot.slot(curve), dark);
    // From one value of an enum to another there is nothing between.
    const paths = curve.signal.names && uPlot.paths.stepped?.({ align: 1 });
    return { scale: `y${this.plot.side(curve)}`, stroke: colour, dash: dash.length ? dash : undefined, width: 1.5, points: { show: false }, spanGaps: false, paths };
  }

  /// Draws the news and the cursor; out of sight, only the legend's values are renewed.
  draw(isSeen = true, anyway = false) {
    const { plot, u } = this;
    if (!u || u.series.length !== plot.curves.length + 1) return;
    this.#span = plots.seen(plot);
    this.#base = plots.base(plot);
    const state = `${plot.curves.map((c) => (c.frozen ? c.frozen.n : c.changes)).join()} ${this.#span.from} ${this.#span.to} ${plot.held.join()} ${plots.mark}`;
    if (isSeen && (state !== this.#drawn || anyway)) {
      this.#drawn = state;
      this.#joined.fill(plot.curves.map((c) => c.seen), this.#span.from, this.#span.to, this.#base);
      // Drawn at once, so that it is known how long it takes.
      u.batch(() => u.setData(this.#joined.data as unknown as uPlot.AlignedData));
    }
    if (isSeen) this.#place(u);
    this.#tell(state);
  }

  #tell(state: string) {
    const { cursor, mark } = plots;
    const told = `${state} ${cursor} ${this.plot.curves.map((c) => `${c.changes} ${c.skipped}`).join()}`;
    if (told === this.#told) return;
    this.#told = told;
    this.axes = [...this.#ticks];
    this.read = this.plot.curves.map((c) => {
      const { seen } = c;
      const isStepped = c.signal.names !== undefined;
      return {
        latest: seen.n && !seen.isHole(seen.n - 1) ? seen.value(seen.n - 1) : undefined,
        cursor: cursor === null ? undefined : seen.near(cursor, isStepped),
        mark: mark === null ? undefined : seen.near(mark, isStepped),
        isAway: seen.n > 0 && (seen.newest < this.#span.from || seen.oldest > this.#span.to),
        scale: this.#ticks[this.plot.side(c)]?.scale,
        points: seen.n, kept: c.track.n, gaps: c.gaps, skipped: c.skipped,
      };
    });
  }

  /// Time at a place on the canvas, s of the host's clock.
  #timeAt(left: number): number {
    return this.#base + (this.u?.posToVal(left, 'x') ?? 0);
  }

  #place(u: uPlot) {
    if (this.#hovers && (u.cursor.left ?? -1) >= 0) plots.cursor = this.#timeAt(u.cursor.left!);
    else {
      const left = plots.cursor === null ? -10 : Math.round(u.valToPos(plots.cursor - this.#base, 'x'));
      const isSeen = left >= 0 && left <= u.over.clientWidth;
      if ((u.cursor.left ?? -10) !== (isSeen ? left : -10)) u.setCursor({ left: isSeen ? left : -10, top: isSeen ? 1 : -10 }, false);
    }
  }

  #selected(u: uPlot) {
    const { left, width } = u.select;
    if (width < 4) return;
    const [from, to] = [this.#timeAt(left), this.#timeAt(left + width)];
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    plots.look(from, to);
  }

  /// A mark, to which differences are told; where one is, it goes.
  marks(left: number) {
    const { u } = this;
    if (!u) return;
    this.#marked = plots.mark;
    const isHere = plots.mark !== null && Math.abs(u.valToPos(plots.mark - this.#base, 'x') - left) < NEAR;
    plots.mark = isHere ? null : this.#timeAt(left);
  }

  /// A double click is no mark: that of its first click goes.
  #returns() {
    plots.mark = this.#marked;
    plots.return();
  }

  /// Units of the axes, and the mark.
  #onto(u: uPlot, ink: string, accent: string) {
    const { ctx, bbox } = u;
    const ratio = devicePixelRatio;
    ctx.save();
    ctx.fillStyle = ink;
    ctx.font = `${11 * ratio}px system-ui`;
    ctx.textBaseline = 'middle';
    // A power of ten without a unit stands within.
    const y = bbox.top + (bbox.top < ABOVE * ratio ? 8 : -ABOVE / 2) * ratio;
    ctx.textAlign = 'left';
    if (this.#ticks[0]?.unit) ctx.fillText(this.#ticks[0].unit, bbox.top < ABOVE * ratio ? bbox.left + 4 * ratio : Math.max(4 * ratio, bbox.left - 44 * ratio), y);
    ctx.textAlign = 'right';
    if (this.#ticks[1]?.unit) ctx.fillText(this.#ticks[1].unit, Math.min(u.width * ratio - 4 * ratio, bbox.left + bbox.width + 44 * ratio), y);
    if (plots.mark !== null) {
      const x = u.valToPos(plots.mark - this.#base, 'x', true);
      if (x >= bbox.left && x <= bbox.left + bbox.width) {
        ctx.strokeStyle = accent;
        ctx.lineWidth = 1.5 * ratio;
        ctx.setLineDash([5 * ratio, 3 * ratio]);
        ctx.beginPath();
        ctx.moveTo(x, bbox.top);
        ctx.lineTo(x, bbox.top + bbox.height);
        ctx.stroke();
      }
    }
    ctx.restore();
  }

  /// Moves the cursor by parts of what is seen, from its end when there is none.
  step(by: number) {
    const { from, to } = plots.seen(this.plot);
    const at = plots.cursor === null || plots.cursor < from || plots.cursor > to ? to : plots.cursor;
    this.#hovers = false;
    plots.cursor = Math.min(to, Math.max(from, at + (to - from) * by));
  }

  /// Holds what the axes show, or lets them fit again.
  hold(yes: boolean) {
    const { u } = this;
    if (!u) return;
    this.plot.held = [0, 1].map((side) => {
      const scale = u.scales[`y${side}`];
      return yes && scale?.min != null && scale.max != null ? [scale.min, scale.max] : null;
    });
  }

  destroy() {
    if (this.#hovers) plots.cursor = null;
    this.u?.destroy();
    this.u = undefined;
  }
}

/// A little more than all that is seen.
function fit(low: number | null, high: number | null): [number, number] {
  if (low === null || high === null || !Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
  const size = Math.max(Math.abs(low), Math.abs(high));
  // A constant is seen in the middle, not as the noise of its last digit.
  const room = high - low > size * 1e-12 ? (high - low) * 0.06 : size * 0.05 || 1;
  return [low - room, high + room];
}

/// Wide enough for its numbers; it does not shrink again by a little, so that the curves stand still.
function widest(u: uPlot, values: string[] | null, index: number, cycle: number): number {
  const axis = u.axes[index] as uPlot.Axis & { _size: number };
  if (cycle > 1) return axis._size;
  u.ctx.save();
  u.ctx.font = `${11 * devicePixelRatio}px system-ui`;
  const most = Math.max(0, ...(values ?? []).map((t) => u.ctx.measureText(t ?? '').width)) / devicePixelRatio;
  u.ctx.restore();
  const size = Math.max(40, Math.ceil(most) + 12);
  return axis._size >= size && axis._size - size < 16 ? axis._size : size;
}

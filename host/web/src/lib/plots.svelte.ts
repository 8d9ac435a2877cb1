/// The plots of this page: their curves, the part of their time that is seen, and the cursor.
///
/// Invariant: pause, zoom, cursor and mark are common to all plots, in s of the host's monotonic clock. A
/// plot has two axes at most: a third unit is refused in words. A pause shows a copy; new points are kept on.
import { page } from './page.svelte';
import { MOST_CURVES } from './palette';
import { Curve, nameOf, sameSignal, signalFrom, unitKey, type Signal } from './signals.svelte';
import { unitOf } from './si';
import { system } from './system.svelte';
import { componentOf } from './words';

/// Drag and drop: a signal as JSON, and a curve by its number.
export const SIGNAL = 'application/x-trocar-signal';
export const CURVE = 'application/x-trocar-curve';
/// Shortest time that is zoomed to, s.
const SHORTEST = 1e-4;

export interface Span {
  from: number;
  to: number;
}

export class Plot {
  curves = $state.raw<Curve[]>([]);
  /// Lowest and highest of an axis that is held, left and right.
  held = $state.raw<([number, number] | null)[]>([null, null]);
  /// Looks of the curves, by number: they do not change while others leave.
  #slots = new Map<Curve, number>();

  constructor(public number: number) {}

  /// Units of the axes, left and right, as keys.
  get units(): string[] {
    return [...new Set(this.curves.map((c) => unitKey(c.signal)))];
  }

  side(curve: Curve): number {
    return Math.max(0, this.units.indexOf(unitKey(curve.signal)));
  }

  slot(curve: Curve): number {
    return this.#slots.get(curve) ?? 0;
  }

  /// Why the signal has no place here; empty: it has.
  why(signal: Signal): string {
    if (this.curves.some((c) => sameSignal(c.signal, signal))) return `${nameOf(signal)} is in plot ${this.number} already`;
    if (this.curves.length >= MOST_CURVES) return `plot ${this.number} has ${MOST_CURVES} curves, and no room for another one`;
    const { units } = this;
    if (units.length < 2 || units.includes(unitKey(signal))) return '';
    const known = this.curves.filter((c, i, all) => all.findIndex((d) => unitKey(d.signal) === unitKey(c.signal)) === i);
    return `plot ${this.number} has axes for ${known.map((c) => unitName(c.signal)).join(' and ')}; ${nameOf(signal)} is in ${unitName(signal)}, and a third axis there is not: plot it by itself`;
  }

  put(curve: Curve) {
    const used = new Set(this.#slots.values());
    let slot = 0;
    while (used.has(slot)) slot += 1;
    this.#slots.set(curve, slot);
    this.curves = [...this.curves, curve];
  }

  take(curve: Curve) {
    const { units } = this;
    this.#slots.delete(curve);
    this.curves = this.curves.filter((c) => c !== curve);
    if (this.units.join() !== units.join()) this.held = [null, null];
  }

  /// Newest of what is seen, s; NaN: there is nothing.
  get newest(): number {
    return this.curves.reduce((most, c) => (c.seen.n && !(c.seen.newest <= most) ? c.seen.newest : most), Number.NaN);
  }
}

function unitName(s: Signal): string {
  return s.names ? 'the names of an enum' : unitOf(s.unit) || 'numbers without a unit';
}

class Plots {
  all = $state.raw<Plot[]>([]);
  /// Plot that a chosen number goes into; 0: one of its own.
  target = $state(0);
  /// Time that is seen before the newest, s, unless something else is looked at.
  seconds = $state(10);
  paused = $state(false);
  zoom = $state.raw<Span | null>(null);
  cursor = $state.raw<number | null>(null);
  mark = $state.raw<number | null>(null);
  /// Settings of components beside the plots.
  tuning = $state(false);
  /// Zooming paused them: returning goes on.
  #byZoom = false;

  get curves(): Curve[] {
    return this.all.flatMap((p) => p.curves);
  }

  /// Adds a number to a plot, or makes one for it.
  add(signal: Signal, into = this.all.find((p) => p.number === this.target)) {
    page.show('plots');
    const already = into ? undefined : this.all.find((p) => p.curves.every((c) => sameSignal(c.signal, signal)));
    const why = into?.why(signal) ?? already?.why(signal);
    if (why) page.tell(why, true);
    else this.#put(new Curve(signal), into);
  }

  /// Takes a drop on a plot, or beside all of them.
  drop(data: DataTransfer | null, into?: Plot) {
    const moved = data?.getData(CURVE);
    const curve = moved ? this.curves.find((c) => String(c.id) === moved) : undefined;
    const text = data?.getData(SIGNAL);
    if (curve) return this.move(curve, into);
    if (!text) return;
    const signal = signalFrom(text);
    if (!signal) page.tell('what was dropped is not a number of a component', true);
    else if (!system.components.has(componentOf(signal.path))) page.tell(`${componentOf(signal.path)} no longer exists: ${nameOf(signal)} is not plotted`, true);
    else if (into) this.add(signal, into);
    else this.#alone(signal);
  }

  /// Into another plot, or one of its own: with all that is kept of it.
  move(curve: Curve, into?: Plot) {
    const from = this.all.find((p) => p.curves.includes(curve));
    if (!from || from === into || (!into && from.curves.length === 1)) return;
    const why = into?.why(curve.signal);
    if (why) return page.tell(why, true);
    this.#takeOut(curve, from);
    this.#put(curve, into);
  }

  remove(curve: Curve) {
    const from = this.all.find((p) => p.curves.includes(curve));
    curve.close();
    if (from) this.#takeOut(curve, from);
    if (this.all.length === 0) this.continue();
  }

  #alone(signal: Signal) {
    const target = this.target;
    this.target = 0;
    this.add(signal);
    this.target = target;
  }

  #put(curve: Curve, into = this.#made()) {
    if (this.paused && !curve.frozen) curve.frozen = curve.track.copy();
    into.put(curve);
  }

  #made(): Plot {
    const used = new Set(this.all.map((p) => p.number));
    let number = 1;
    while (used.has(number)) number += 1;
    const plot = new Plot(number);
    this.all = [...this.all, plot];
    return plot;
  }

  #takeOut(curve: Curve, from: Plot) {
    from.take(curve);
    if (from.curves.length > 0) return;
    this.all = this.all.filter((p) => p !== from);
    if (this.target === from.number) this.target = 0;
  }

  pause() {
    this.#byZoom = false;
    this.#freeze();
  }

  #freeze() {
    if (this.paused) return;
    this.paused = true;
    for (const c of this.curves) c.frozen = c.track.copy();
  }

  continue() {
    this.paused = this.#byZoom = false;
    this.zoom = null;
    for (const c of this.curves) c.frozen = null;
  }

  /// Back to the newest of what is seen.
  return() {
    if (this.#byZoom) this.continue();
    this.zoom = null;
  }

  /// All that is kept of anything.
  get kept(): Span {
    let [from, to] = [Infinity, -Infinity];
    for (const { seen } of this.curves) if (seen.n) [from, to] = [Math.min(from, seen.oldest), Math.max(to, seen.newest)];
    return { from, to };
  }

  /// The newest of a plot, from which its times count; of an empty one, that of all.
  base(plot: Plot): number {
    return [plot.newest, this.kept.to].find(Number.isFinite) ?? 0;
  }

  /// The time that is seen of a plot.
  seen(plot: Plot): Span {
    if (this.zoom) return this.zoom;
    const to = this.base(plot);
    return { from: to - this.seconds, to };
  }

  /// Shows this time, and pauses: it would go away under the eye.
  look(from: number, to: number) {
    if (![from, to].every(Number.isFinite) || !this.curves.some((c) => c.seen.n)) return;
    if (!this.paused) {
      this.#freeze();
      this.#byZoom = true;
    }
    const kept = this.kept;
    const length = Math.max(SHORTEST, Math.min(to - from, Math.max(this.seconds, kept.to - kept.from)));
    const middle = (from + to) / 2;
    // A part of what is kept stays in sight.
    const begin = Math.min(Math.max(middle - length / 2, kept.from - length / 2), kept.to - length / 2);
    this.zoom = { from: begin, to: begin + length };
  }

  /// Below 1: closer.
  scale(by: number, around?: number, of: Span = this.#now()) {
    // Without a place: that of the cursor, or the newest.
    const pointed = this.cursor !== null && this.cursor >= of.from && this.cursor <= of.to ? this.cursor : undefined;
    const at = around ?? pointed ?? (this.zoom ? (of.from + of.to) / 2 : of.to);
    this.look(at - (at - of.from) * by, at + (of.to - at) * by);
  }

  /// By so many times what is seen.
  shift(by: number, of: Span = this.#now()) {
    const way = (of.to - of.from) * by;
    this.look(of.from + way, of.to + way);
  }

  #now(): Span {
    const { to } = this.kept;
    return this.zoom ?? { from: to - this.seconds, to };
  }
}

export const plots = new Plots();

/// The time that is seen of a plot, in words.
export function spanOf(plot: Plot): string {
  if (!plots.zoom) return `last ${plots.seconds} s${plots.paused ? ' before the pause' : ''}`;
  const { from, to } = plots.zoom;
  const digits = Math.max(0, Math.min(6, 2 - Math.floor(Math.log10(to - from))));
  const base = plots.base(plot);
  return `${(from - base).toFixed(digits)} … ${(to - base).toFixed(digits)} s`;
}

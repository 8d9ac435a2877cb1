/// Numbers with their units as people read them: 637 µm, 1.2 mN, 1.5 kHz.
///
/// Invariant: pure. A factor and its prefix go together, and a unit takes a prefix only where SI gives it
/// one: never a squared one, nor `%`, `deg` or `px`, nor one of two that the value decides (m|rad).

/// Largest prefixes first, as powers of ten.
const PREFIXES: [string, number][] = [['G', 9], ['M', 6], ['k', 3], ['', 0], ['m', -3], ['µ', -6], ['n', -9], ['p', -12]];
/// Symbols that take prefixes, with the powers of the smallest and the largest that people use.
const TAKES: Record<string, [number, number]> = {
  m: [-12, 3], s: [-12, 0], g: [-9, 3], N: [-9, 6], Hz: [-3, 9], V: [-9, 6], A: [-12, 6], W: [-9, 9], Pa: [-3, 9], J: [-9, 9],
  rad: [-9, 0], K: [-6, 0], T: [-9, 0], F: [-12, 0], H: [-9, 0], C: [-12, 0], Ω: [-3, 9], B: [0, 9],
};
/// Beyond these a number without a prefix is written with a power of ten.
const LARGE = 1e9;
const SMALL = 1e-4;

/// A way to write numbers of one unit: value / factor is shown, in `unit`.
export interface Scale {
  factor: number;
  unit: string;
}

/// The first symbol of a unit as a base with a power of ten, and what follows it.
function taken(unit: string): { base: string; power: number; rest: string } | null {
  if (unit.includes('|')) return null;
  const whole = unit === 'Nm' ? 'N·m' : unit;
  const [, symbol = '', rest = ''] = /^([^/·.*^²³⁻\s-]+)(.*)$/.exec(whole) ?? [];
  if (/^[\^²³⁻-]/.test(rest)) return null;
  if (symbol in TAKES) return { base: symbol, power: 0, rest };
  const prefix = PREFIXES.find(([p]) => p === symbol[0]?.replace('μ', 'µ').replace('u', 'µ'));
  const base = symbol.slice(1);
  return prefix && base in TAKES ? { base, power: prefix[1], rest } : null;
}

/// A unit as it is printed: N·m, m/s², m or rad.
export function unitOf(unit: string): string {
  if (unit === '1') return '';
  return (unit === 'Nm' ? 'N·m' : unit).replaceAll('|', ' or ').replace(/[.*]/g, '·').replace(/\^2/g, '²').replace(/\^3/g, '³').replace(/^[uμ](?=[a-zA-Z])/, 'µ');
}

/// The scale for numbers up to this size.
export function scaleFor(unit: string, size: number): Scale {
  const of = taken(unit);
  if (!of || !Number.isFinite(size) || size === 0) return { factor: 1, unit: unitOf(unit) };
  const [low, high] = TAKES[of.base]!;
  const inBase = size * 10 ** of.power;
  const fits = PREFIXES.filter(([, power]) => power >= low && power <= high);
  // A thousand less a rounding error has the prefix of a thousand.
  const [prefix, power] = fits.find(([, power]) => inBase >= 10 ** power * (1 - 1e-9)) ?? fits[fits.length - 1]!;
  return { factor: 10 ** (power - of.power), unit: prefix + of.base + unitOf(of.rest) };
}

function word(value: number): string {
  return Number.isNaN(value) ? 'not a number' : value > 0 ? 'infinity' : 'minus infinity';
}

/// So many significant digits at least; whole numbers keep all of theirs.
function digitsOf(value: number, digits: number, exact: boolean): string {
  const size = Math.abs(value);
  if (exact && Number.isInteger(value) && size < 1e15) return String(value + 0);
  if (size !== 0 && (size >= LARGE || size < SMALL)) return value.toExponential(digits - 1).replace('e+', 'e');
  const before = size < 1 ? 1 : Math.floor(Math.log10(size)) + 1;
  return value.toPrecision(Math.max(digits, before));
}

/// A value with its unit; its digits do not come and go while it changes. `like`: the scale of the axis
/// beside it, which is kept unless the value is far smaller or larger.
export function reading(value: number, unit: string, digits = 5, like?: Scale): string {
  if (!Number.isFinite(value)) return word(value);
  const there = like && Math.abs(value / like.factor);
  if (like && there !== undefined && (there === 0 || (there >= 1e-3 && there < 1e5))) {
    return `${digitsOf(value / like.factor, digits, taken(unit) === null)} ${like.unit}`.trim();
  }
  const rounded = Number(value.toPrecision(digits));
  const { factor, unit: shown } = scaleFor(unit, Math.abs(rounded));
  // A number of nothing, or of pixels, may be a count.
  return `${digitsOf(value / factor, digits, taken(unit) === null)} ${shown}`.trim();
}

/// A value with its unit in as few digits as say it.
export function written(value: number, unit: string, digits = 4): string {
  return reading(value, unit, digits).replace(/^(-?\d+\.\d*?)0+(?=$|[e ])/, '$1').replace(/\.(?=$|[e ])/, '');
}

export interface Ticks {
  texts: string[];
  unit: string;
  /// The scale for single values of that axis.
  scale: Scale;
}

/// Ticks of one axis: one prefix for all, which stands in the unit, and the digits neighbours need to differ.
export function ticks(at: readonly number[], unit: string): Ticks {
  const most = at.reduce((size, v) => Math.max(size, Math.abs(v)), 0);
  const prefixed = scaleFor(unit, most);
  let scale = prefixed;
  const shown = most / scale.factor;
  if (shown >= 1e6 || (shown > 0 && shown < 1e-3)) {
    const power = 3 * Math.floor(Math.log10(shown) / 3 + 1e-9);
    scale = { factor: scale.factor * 10 ** power, unit: `×1e${power} ${scale.unit}`.trim() };
  }
  const values = at.map((v) => v / scale.factor);
  const step = values.reduce((least, v, i) => (i ? Math.min(least, Math.abs(v - values[i - 1]!)) : least), Infinity);
  let decimals = 0;
  const isRounded = (v: number) => Math.abs(v - Number(v.toFixed(decimals))) <= Math.min(step, 1) * 1e-3;
  while (decimals < 15 && !values.every(isRounded)) decimals += 1;
  return { texts: values.map((v) => v.toFixed(decimals).replace(/^-(?=[0.]*$)/, '')), unit: scale.unit, scale: prefixed };
}

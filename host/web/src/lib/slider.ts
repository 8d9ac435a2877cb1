/// A slider's way between two limits: even, or by powers of ten where these are far apart.
///
/// Invariant: both ends are the limits themselves, and values between have only digits a hand can set.
import type { Schema } from './schema';

/// Steps from one end to the other, unless there are fewer whole numbers.
const STEPS = 1000;
/// A way that is even would leave small values no room beyond this, of high / low.
const DECADES = 100;
/// Limits farther apart than this have no slider: a hand could set nothing with it.
const TOO_FAR = 1e6;

export interface Way {
  low: number;
  high: number;
  /// From one end to the other.
  steps: number;
  isLog: boolean;
  whole: boolean;
}

export function wayOf(s: Schema, whole: boolean): Way | undefined {
  if (s.minimum === undefined || s.maximum === undefined) return undefined;
  const [low, high] = whole ? [Math.ceil(s.minimum), Math.floor(s.maximum)] : [s.minimum, s.maximum];
  if (!(high > low) || !Number.isFinite(high - low)) return undefined;
  // Few whole numbers have a step each: a key moves to the next.
  if (whole && high - low <= STEPS) return { low, high, steps: high - low, isLog: false, whole };
  const isLog = low > 0 && high / low > DECADES;
  return isLog || high - low <= TOO_FAR ? { low, high, steps: STEPS, isLog, whole } : undefined;
}

/// The place of a value, of the way's steps.
export function placeOf({ low, high, steps, isLog }: Way, value: number): number {
  const at = isLog ? (Math.log10(value) - Math.log10(low)) / (Math.log10(high) - Math.log10(low)) : (value - low) / (high - low);
  return Math.round(steps * Math.min(1, Math.max(0, at || 0)));
}

export function valueOf({ low, high, steps, isLog, whole }: Way, place: number): number {
  if (place <= 0) return low;
  if (place >= steps) return high;
  const at = place / steps;
  const value = isLog ? 10 ** (Math.log10(low) + (Math.log10(high) - Math.log10(low)) * at) : low + (high - low) * at;
  if (whole) return Math.round(value);
  return Math.min(high, Math.max(low, isLog ? Number(value.toPrecision(3)) : toStep(value, (high - low) / steps)));
}

/// To the power of ten below the step, without the last digits that counting in binary leaves.
function toStep(value: number, step: number): number {
  const unit = 10 ** Math.floor(Math.log10(step));
  return Number((Math.round(value / unit) * unit).toPrecision(14));
}

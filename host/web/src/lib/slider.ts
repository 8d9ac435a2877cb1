/// The way of a slider between two limits: even, or by powers of ten where these are far apart.
///
/// Invariant: both ends are the limits themselves, and what is between has no more digits than a hand can set.
import type { Schema } from './schema';

/// Steps from one end to the other.
export const STEPS = 1000;
/// A way that is even would leave small values no room beyond this, of high / low.
const DECADES = 100;
/// Limits farther apart than this have no slider: a hand could set nothing with it.
const TOO_FAR = 1e6;

export interface Way {
  low: number;
  high: number;
  isLog: boolean;
  whole: boolean;
}

export function wayOf(s: Schema, whole: boolean): Way | undefined {
  const { minimum: low, maximum: high } = s;
  if (low === undefined || high === undefined || !(high > low) || !Number.isFinite(high - low)) return undefined;
  const isLog = low > 0 && high / low > DECADES;
  return isLog || high - low <= TOO_FAR ? { low, high, isLog, whole } : undefined;
}

/// The place of a value, of STEPS.
export function placeOf({ low, high, isLog }: Way, value: number): number {
  const at = isLog ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  return Math.round(STEPS * Math.min(1, Math.max(0, at || 0)));
}

export function valueOf({ low, high, isLog, whole }: Way, place: number): number {
  if (place <= 0) return low;
  if (place >= STEPS) return high;
  const at = place / STEPS;
  const value = isLog ? low * (high / low) ** at : low + (high - low) * at;
  if (whole) return Math.round(value);
  // Log: three digits; even: to the step.
  const decimals = isLog ? 2 - Math.floor(Math.log10(value)) : -Math.floor(Math.log10((high - low) / STEPS));
  const unit = 10 ** Math.max(-15, Math.min(15, decimals));
  return Math.min(high, Math.max(low, Math.round(value * unit) / unit));
}

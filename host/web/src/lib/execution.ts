/// A component's execution as a form: the choices its class is made for, and its default.
///
/// Invariant: nothing here decides what is sent; the server judges.
import type { ClassInfo, Execution } from '../gen/trocar/v1/types_pb';
import type { Schema, Values } from './schema';
import { system } from './system.svelte';

type Duration = { seconds: bigint; nanos: number };

/// All there are, for a class that names none.
const MODELS = ['periodic', 'continuous', 'on_signal', 'on_callback', 'exec_in', 'exec_out', 'stream', 'none'];

const hertz = (period?: Duration) => (period ? rounded(1 / (Number(period.seconds) + period.nanos * 1e-9)) : undefined);
/// A period of whole ns is the rate that somebody wrote.
const rounded = (hz: number) => Number(hz.toPrecision(9));

/// Such an execution as values of the form.
export function valuesOf(e?: Execution): Values {
  const rate = e?.rateHz ?? hertz(e?.period);
  return { model: e?.model ?? '', ...(rate === undefined ? {} : { rate_hz: rate }), ...(e?.inside ? { inside: e.inside } : {}), ...(e?.streamOf ? { stream_of: e.streamOf } : {}) };
}

export function formOf(info?: ClassInfo): Schema {
  const limits = info?.executionLimits;
  const usual = valuesOf(info?.execution);
  const component = (description: string): Schema => ({ type: 'string', description });
  return {
    type: 'object',
    properties: {
      model: { enum: limits?.models.length ? limits.models : MODELS, default: usual.model, description: 'What makes it step; its class is made for these.' },
      rate_hz: { type: 'number', unit: 'Hz', default: usual.rate_hz, minimum: hertz(limits?.maxPeriod), maximum: hertz(limits?.minPeriod), description: 'Steps per second, where it has a period.' },
      inside: component('exec_in, exec_out: process/component inside whose step it runs.'),
      stream_of: component('stream: process/component in whose stream it runs.'),
    },
  };
}

/// A change of the form as it is sent; undefined: nothing was changed.
export function changeOf(change: unknown): Partial<Pick<Execution, 'model' | 'rateHz' | 'inside' | 'streamOf'>> | undefined {
  if (!change) return undefined;
  const { model, rate_hz, inside, stream_of } = change as Record<string, string | number | null | undefined>;
  const text = (value: string | number | null | undefined) => (value === undefined ? undefined : String(value ?? ''));
  return { model: text(model), rateHz: rate_hz === undefined || rate_hz === null ? undefined : Number(rate_hz), inside: text(inside), streamOf: text(stream_of) };
}

/// In one line: the models and rates a class is made for.
export function madeFor(info?: ClassInfo): string {
  const limits = info?.executionLimits;
  const [low, high] = [hertz(limits?.maxPeriod), hertz(limits?.minPeriod)];
  const rates = low === undefined && high === undefined ? '' : `, ${low ?? 0} … ${high ?? '∞'} Hz`;
  return `${limits?.models.length ? limits.models.join(', ') : 'any model'}${rates}`;
}

/// Whether a component steps at a rate that is known, by itself or with the one whose thread or step it
/// shares: not where a signal, a callback or what it finds to do makes it step.
export function isPaced(path: string, deep = 0): boolean {
  const e = system.components.get(path)?.execution;
  if (!e || deep > 8) return false;
  const [rate, other] = [e.rateHz ?? hertz(e.period), e.inside || e.streamOf];
  if (other) return isPaced(other, deep + 1);
  return (e.model === 'periodic' || e.model === 'stream') && rate !== undefined && rate > 0;
}

/// What a form is made of: JSON Schema as classes give it, and as `argument.ts` makes it of a command's type.
///
/// Invariant: nothing here decides what is sent; what is wrong is said beside the field, and the server judges.
import { count } from './words';

export interface Schema {
  type?: string | string[];
  title?: string;
  description?: string;
  default?: unknown;
  enum?: unknown[];
  const?: unknown;
  minimum?: number;
  maximum?: number;
  exclusiveMinimum?: number;
  exclusiveMaximum?: number;
  maxLength?: number;
  minItems?: number;
  maxItems?: number;
  unit?: string;
  live?: boolean;
  properties?: Record<string, Schema>;
  required?: string[];
  items?: Schema;
  oneOf?: Schema[];
  anyOf?: Schema[];
  /// Of payload types: lowest and highest number the type holds at all.
  holds?: [number, number];
  /// Most bytes of a text in UTF-8.
  bytes?: number;
  /// May be left out of its structure, and begins so.
  optional?: boolean;
}

export type Values = Record<string, unknown>;
export type Kind = 'group' | 'list' | 'enum' | 'boolean' | 'number' | 'integer' | 'string' | 'numbers' | 'json';

/// Numbers beyond so many share one line of text.
const MOST_ROWS = 16;

export const isGroup = (v: unknown): v is Values => typeof v === 'object' && v !== null && !Array.isArray(v);
const isNumeric = (kind: Kind) => kind === 'number' || kind === 'integer';

/// Whole numbers may have 64 bits: what a JSON number cannot hold exactly comes and goes as text.
export const isWhole = (s: Schema) => kindOf(s) === 'integer';

/// Number of items, where no other is allowed.
export function fixedLength(s: Schema): number | undefined {
  return s.minItems !== undefined && s.minItems === s.maxItems ? s.minItems : undefined;
}

/// What an item of a list is entered with: it has the unit of its list, and changes when that may.
export function itemOf(s: Schema): Schema {
  return { ...s.items, unit: s.items?.unit ?? s.unit, live: s.live };
}

/// How it is entered; JSON, where the fields could not show all of what it is now.
export function kindOf(s: Schema, value?: unknown): Kind {
  const kind = natural(s, value);
  return value === undefined || value === null || fits(kind, s, value) ? kind : 'json';
}

function natural(s: Schema, value: unknown): Kind {
  const type = Array.isArray(s.type) ? s.type.find((t) => t !== 'null') : s.type;
  if (s.enum) return 'enum';
  if (type === 'object' && s.properties && Object.keys(s.properties).length) return 'group';
  if (type === 'array' && s.items) {
    const long = Math.max(s.maxItems ?? 0, Array.isArray(value) ? value.length : 0) > MOST_ROWS;
    return long && isNumeric(kindOf(s.items)) ? 'numbers' : 'list';
  }
  return type === 'boolean' || type === 'number' || type === 'integer' || type === 'string' ? type : 'json';
}

function fits(kind: Kind, s: Schema, value: unknown): boolean {
  const isWritten = (v: unknown) => typeof v === 'number' || typeof v === 'string';
  switch (kind) {
    case 'group':
      return isGroup(value);
    case 'list':
      return Array.isArray(value) && value.length === (fixedLength(s) ?? value.length);
    case 'numbers':
      return Array.isArray(value) && value.every(isWritten);
    case 'number':
    case 'integer':
      return isWritten(value);
    case 'boolean':
    case 'string':
      return typeof value === kind;
    default:
      return true;
  }
}

/// Shown beside the field: the limits of what is accepted.
export function rangeOf(s: Schema): string {
  const low = s.minimum ?? s.exclusiveMinimum;
  const high = s.maximum ?? s.exclusiveMaximum;
  if (low === undefined && high === undefined) return '';
  return `${low ?? ''} … ${high ?? ''}`;
}

/// What is wrong with what was entered, as far as its description says; empty: nothing.
export function whyWrong(s: Schema, kind: Kind, value: unknown): string {
  if (value === undefined || value === null) return '';
  if (isNumeric(kind)) return wrongNumber(s, kind === 'integer', value);
  if (kind === 'string') {
    const bytes = s.bytes === undefined ? 0 : new TextEncoder().encode(String(value)).length;
    return bytes > (s.bytes ?? 0) ? `${bytes} bytes; at most ${s.bytes} fit` : '';
  }
  if (kind !== 'numbers' || !Array.isArray(value)) return '';
  const n = fixedLength(s);
  if (n !== undefined && value.length !== n) return `${count(value.length, 'number')}; exactly ${n} needed`;
  if (value.length > (s.maxItems ?? Infinity)) return `${count(value.length, 'number')}; at most ${s.maxItems} fit`;
  const item = itemOf(s);
  for (const [i, v] of value.entries()) {
    const why = wrongNumber(item, kindOf(item) === 'integer', v);
    if (why) return `number ${i}: ${why}`;
  }
  return '';
}

function wrongNumber(s: Schema, whole: boolean, value: unknown): string {
  if (value === '') return 'a number is missing';
  if (!whole && /^(NaN|-?Infinity)$/.test(String(value))) return '';
  const n = Number(value);
  if (Number.isNaN(n) || (typeof value === 'string' && !(whole && /^-?\d+$/.test(value)))) return `${String(value)} is not a number`;
  if (whole && !Number.isInteger(n)) return `${n} is not a whole number`;
  const unit = s.unit ? ` ${s.unit}` : '';
  for (const low of [s.minimum, s.holds?.[0]]) if (low !== undefined && n < low) return `${value} is below ${low}${unit}`;
  for (const high of [s.maximum, s.holds?.[1]]) if (high !== undefined && n > high) return `${value} is above ${high}${unit}`;
  if (s.exclusiveMinimum !== undefined && n <= s.exclusiveMinimum) return `${value} is not above ${s.exclusiveMinimum}${unit}`;
  if (s.exclusiveMaximum !== undefined && n >= s.exclusiveMaximum) return `${value} is not below ${s.exclusiveMaximum}${unit}`;
  return '';
}

/// A whole value to begin from.
export function begin(s: Schema): unknown {
  if (s.default !== undefined) return structuredClone(s.default);
  switch (kindOf(s)) {
    case 'group':
      return Object.fromEntries(Object.entries(s.properties ?? {}).filter(([, part]) => !part.optional).map(([key, part]) => [key, begin(part)]));
    case 'list':
    case 'numbers':
      return Array.from({ length: fixedLength(s) ?? 0 }, () => begin(itemOf(s)));
    case 'enum':
      return s.enum?.[0];
    case 'boolean':
      return false;
    case 'number':
    case 'integer':
      return 0;
    case 'string':
      return '';
    default:
      return null;
  }
}

/// What a class takes where nothing is said.
export function defaults(s: Schema): Values {
  const out: Values = {};
  for (const [key, part] of Object.entries(s.properties ?? {})) {
    if (part.default !== undefined) out[key] = structuredClone(part.default);
    else if (kindOf(part) === 'group') out[key] = defaults(part);
  }
  return out;
}

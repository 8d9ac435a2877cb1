/// Values as people write them in a line or a box of text.
///
/// Invariant: what cannot be read as what it should be goes to the server as it was typed, which knows best what to say; JSON that is
/// none is refused here, as nobody could say what was meant.
import { isGroup, isWhole, itemOf, type Kind, type Schema } from './schema';

/// What the value is to be, out of the text; undefined: nothing.
/// Throws a sentence where that cannot be said.
export function read(s: Schema, kind: Kind, text: string): unknown {
  switch (kind) {
    case 'number':
    case 'integer':
      return text.trim() === '' ? undefined : number(s, text.trim());
    case 'numbers':
      return text.split(/[\s,;]+/).filter(Boolean).map((part) => number(itemOf(s), part));
    case 'json':
      try {
        return text.trim() === '' ? undefined : JSON.parse(text);
      } catch {
        throw new Error('not valid JSON: a bracket, comma or quote is missing or one too many');
      }
    default:
      return text;
  }
}

function number(s: Schema, text: string): number | string {
  const n = Number(text);
  if (!Number.isFinite(n)) return text;
  return isWhole(s) && !Number.isSafeInteger(n) && /^[-+]?\d+$/.test(text) ? text.replace('+', '') : n;
}

export function write(kind: Kind, value: unknown): string {
  if (value === undefined || (value === null && kind !== 'json')) return '';
  if (kind === 'numbers') return (value as unknown[]).join(', ');
  if (kind !== 'json') return String(value);
  // Structures over several lines; a list of plain values reads best in one.
  const isWide = isGroup(value) || (Array.isArray(value) && value.some((v) => typeof v === 'object'));
  return JSON.stringify(value, null, isWide ? 2 : undefined);
}

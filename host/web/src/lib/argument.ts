/// The argument of a command as a form has it: names, units, limits and docs out of its type.
///
/// Invariant: it allows all that the server takes; reserved fields are left out, stamps may be.
import { Primitive, type Argument, type TypeInfo } from '../gen/trocar/v1/types_pb';
import type { Schema } from './schema';

const HOLDS: Partial<Record<Primitive, [number, number]>> = {
  [Primitive.U8]: [0, 2 ** 8 - 1],
  [Primitive.I8]: [-(2 ** 7), 2 ** 7 - 1],
  [Primitive.U16]: [0, 2 ** 16 - 1],
  [Primitive.I16]: [-(2 ** 15), 2 ** 15 - 1],
  [Primitive.U32]: [0, 2 ** 32 - 1],
  [Primitive.I32]: [-(2 ** 31), 2 ** 31 - 1],
  [Primitive.U64]: [0, Infinity],
  [Primitive.STAMP]: [0, Infinity],
};

export function schemaOf({ type, unit, doc, min, max }: Argument): Schema {
  const s = typed(type, unit);
  return { ...s, title: type?.name, description: described(doc, s), minimum: min, maximum: max };
}

function typed(t: TypeInfo | undefined, unit: string): Schema {
  const known: Schema = unit ? { unit } : {};
  switch (t?.shape.case) {
    case 'primitive':
      return { ...known, ...primitive(t.shape.value) };
    case 'array':
      return { ...known, type: 'array', items: typed(t.shape.value.item, ''), minItems: t.shape.value.n, maxItems: t.shape.value.n };
    case 'list':
      return { ...known, type: 'array', items: typed(t.shape.value.item, ''), maxItems: t.shape.value.n, description: `At most ${t.shape.value.n}` };
    case 'text':
      return { ...known, type: 'string', bytes: t.shape.value, description: `At most ${t.shape.value} bytes` };
    case 'enumeration':
      return { enum: t.shape.value.values.map((v) => v.name) };
    case 'structure': {
      const fields = t.shape.value.fields.filter((f) => !f.name.startsWith('reserved'));
      const of = (f: (typeof fields)[number]): Schema => {
        const s = typed(f.type, f.unit);
        return { ...s, description: described([f.doc, f.frame && `in frame ${f.frame}`].filter(Boolean).join('; '), s) };
      };
      return { type: 'object', properties: Object.fromEntries(fields.map((f) => [f.name, of(f)])), description: t.shape.value.doc };
    }
    default:
      return {};
  }
}

/// What it is for, before what its type says.
function described(doc: string, s: Schema): string {
  if (s.type === 'object') return doc || (s.description ?? '');
  return [doc, s.description].filter(Boolean).join('. ');
}

function primitive(p: Primitive): Schema {
  switch (p) {
    case Primitive.BOOL:
      return { type: 'boolean' };
    case Primitive.F32:
    case Primitive.F64:
      return { type: 'number' };
    case Primitive.STAMP:
      return { type: 'integer', optional: true, default: 0, unit: 'ns', holds: HOLDS[p], description: 'Of the host’s clock' };
    default:
      return { type: 'integer', holds: HOLDS[p] };
  }
}

/// Widths of words, before they are drawn.
///
/// Invariant: it is the page's own font that is measured, so that what is reckoned has room on each machine.

/// Sizes are linear: all is measured at this one, px.
const AT = 100;
/// More than this many words are not remembered.
const MOST = 4000;
const known = new Map<string, number>();
let pen: CanvasRenderingContext2D | null | undefined;

/// The width of a text in letters of 1 px, px.
export function wide(text: string, isBold = false): number {
  const key = `${isBold ? 'b' : 'n'}${text}`;
  const before = known.get(key);
  if (before !== undefined) return before;
  pen ??= document.createElement('canvas').getContext('2d');
  // As wide as most are, where nothing can be measured.
  if (!pen) return text.length * 0.6;
  pen.font = `${isBold ? 600 : 400} ${AT}px ${getComputedStyle(document.body).fontFamily}`;
  const width = pen.measureText(text).width / AT;
  if (known.size >= MOST) known.clear();
  known.set(key, width);
  return width;
}

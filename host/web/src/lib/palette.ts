/// Colours and strokes of curves: after Okabe and Ito, told apart with every kind of colour vision.
///
/// Invariant: two curves of a plot never look the same; from the fourth on they differ by their strokes, too.
const LIGHT = ['#0072b2', '#c94f00', '#007a57', '#a3457f', '#7a5c00', '#4a4a4a'];
const DARK = ['#56b4e9', '#f0932b', '#2fc59a', '#e29bc4', '#f0e442', '#d0d0d0'];
const DASHES: number[][] = [[], [9, 4], [2, 3], [9, 3, 2, 3]];

/// Curves of a plot at most: each has a look of its own.
export const MOST_CURVES = 12;

export interface Look {
  colour: string;
  /// Lengths of its strokes and gaps, px; none = a line.
  dash: number[];
}

export function look(slot: number, dark: boolean): Look {
  const colour = (dark ? DARK : LIGHT)[slot % LIGHT.length]!;
  return { colour, dash: slot < 3 ? [] : DASHES[slot < LIGHT.length ? slot - 2 : ((slot + 1) % 3) + 1]! };
}

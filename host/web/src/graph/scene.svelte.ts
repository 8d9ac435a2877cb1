/// The cards as they stand, for what is drawn between them.
import type { Box } from '../lib/layout';

class Scene {
  /// In the coordinates of the graph.
  cards = $state.raw<Box[]>([]);
  /// A card is on its way with the pointer: wires are not led around it until it stands.
  moving = $state(false);
  /// Letters are drawn so many times as large, so that they can be read from afar.
  letters = $state(1);
}

export const scene = new Scene();

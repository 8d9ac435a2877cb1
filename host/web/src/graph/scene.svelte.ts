/// Parts of the graph, for what is drawn between them.
import { SvelteMap } from 'svelte/reactivity';
import { placed, type Wanted } from '../lib/labels';
import type { Box } from '../lib/layout';

class Scene {
  /// In the coordinates of the graph.
  cards = $state.raw<Box[]>([]);
  /// A card is on its way with the pointer: wires are not led around it until it stands.
  moving = $state(false);
  /// Letters are drawn so many times as large, so that they can be read from afar.
  letters = $state(1);
  /// From afar a label of a wire says a rate and no more, from farther away nothing.
  labels = $state<'all' | 'rate' | 'none'>('all');
  /// Labels that want a place, by the id of their wire.
  wanted = new SvelteMap<string, Wanted>();
  spots = $derived(placed(this.wanted, this.cards));
}

export const scene = new Scene();

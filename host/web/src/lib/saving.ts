/// The running system as a file for this person's disk.
import { gcm, PATIENCE, said } from './api';
import { page } from './page.svelte';

/// Time the browser has to begin, ms.
const BEGINS = 60_000;

export async function save() {
  try {
    const { text, notes } = await gcm.save({}, PATIENCE);
    const link = document.createElement('a');
    link.href = URL.createObjectURL(new Blob([text], { type: 'application/json' }));
    link.download = 'system.json';
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), BEGINS);
    page.tell(['Saved as system.json, for trocar run, up and apply.', ...notes].join(' '));
  } catch (error) {
    page.tell(`Save: ${said(error)}`, true);
  }
}

import { svelte } from '@sveltejs/vite-plugin-svelte';
import { defineConfig } from 'vite';

export default defineConfig({
  plugins: [svelte()],
  build: {
    // Names carry a hash of the contents, and the same sources give the same bytes: a test rebuilds and compares.
    assetsInlineLimit: 0,
    target: 'es2022',
    chunkSizeWarningLimit: 2000,
    modulePreload: { polyfill: false },
    // Whose code is in the files that are served.
    license: { fileName: 'licenses.md' },
  },
});

import { defineConfig } from 'vite'

export default defineConfig({
  // All files except `index.html` are in `assets/` with a digest in their names, so that browsers may cache them indefinitely.
  build: { target: 'es2022', assetsInlineLimit: 0, modulePreload: { polyfill: false }, chunkSizeWarningLimit: 1500 },
  // For `npx vite` together with a running `wandless serve`.
  server: { proxy: { '/v1': 'http://127.0.0.1:8700' } },
})

import { defineConfig } from 'vite'

export default defineConfig({
  // Below `index.html` every file lies in `assets/` under a name with its digest: the service lets browsers keep it for ever.
  build: { target: 'es2022', assetsInlineLimit: 0, modulePreload: { polyfill: false }, chunkSizeWarningLimit: 1500 },
  // `npx vite` beside a running `wandless serve`.
  server: { proxy: { '/v1': 'http://127.0.0.1:8700' } },
})

// What the scene is drawn on, opened before there is anything to draw: the graphics start while the result is on its way.

import { WebGLRenderer } from 'three'

export interface Surface {
  renderer: WebGLRenderer
  /** No graphics card: the processor draws, and is spared what costs most. */
  isSlow: boolean
}

/** Opens a surface; `dispose` its renderer. Fails where the browser has no WebGL 2. */
export function openSurface(): Surface {
  const canvas = document.createElement('canvas')
  const attributes: WebGLContextAttributes = { antialias: false, alpha: false, powerPreference: 'high-performance' }
  const plain = canvas.getContext('webgl2', attributes)
  if (!plain) throw new Error('This browser has no WebGL 2, which the scene is drawn with. The report and the files need none.')
  const isSlow = isDrawnBySoftware(plain)
  // Whether edges are smoothed is settled when a context is made: with a graphics card another one is wanted.
  const renderer = isSlow
    ? new WebGLRenderer({ canvas, context: plain })
    : new WebGLRenderer({ antialias: true, powerPreference: 'high-performance' })
  if (!isSlow) plain.getExtension('WEBGL_lose_context')?.loseContext()
  renderer.shadowMap.enabled = !isSlow
  renderer.setPixelRatio(isSlow ? 1 : Math.min(devicePixelRatio, 2))
  renderer.autoClear = false
  return { renderer, isSlow }
}

export function closeSurface({ renderer }: Surface) {
  renderer.dispose()
  renderer.forceContextLoss()
}

function isDrawnBySoftware(context: WebGL2RenderingContext) {
  const info = context.getExtension('WEBGL_debug_renderer_info')
  const name = info ? String(context.getParameter(info.UNMASKED_RENDERER_WEBGL)) : ''
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name)
}

// WebGL surface of the scene. It is opened before the result is loaded, so that both happen at the same time.

import { WebGLRenderer } from 'three'

export interface Surface {
  renderer: WebGLRenderer
  /** Software rendering: shadows and antialiasing are switched off. */
  isSlow: boolean
}

/** Opens a surface. Throws if the browser does not support WebGL 2. */
export function openSurface(): Surface {
  const canvas = document.createElement('canvas')
  const attributes: WebGLContextAttributes = { antialias: false, alpha: false, powerPreference: 'high-performance' }
  const plain = canvas.getContext('webgl2', attributes)
  if (!plain) throw new Error('The scene needs WebGL 2, which this browser does not support. The report and the files work without it.')
  const isSlow = isDrawnBySoftware(plain)
  // Antialiasing is fixed when a context is created, so that hardware rendering needs a second context.
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

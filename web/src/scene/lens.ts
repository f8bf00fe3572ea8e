// Lens distortion of the current camera, applied to everything that is drawn.

import type { Material } from 'three'
import type { Camera } from '../data/motion'
import { isDistorted, normalizedFromPixel } from '../data/projection'

const DECLARATIONS = /* glsl */ `
uniform int lensModel; // 0: none, 1: polynomial or rational, 2: fisheye
uniform float lensRadial[6];
uniform vec2 lensTangential;
uniform float lensReach; // squared radius beyond which points are not distorted: the polynomial may not be monotonic there
vec2 distorted(vec2 n) {
  float r2 = dot(n, n);
  if (r2 > lensReach) return n;
  if (lensModel == 2) {
    float r = sqrt(r2);
    float theta = atan(r);
    float s = theta * theta;
    float factor = 1.0 + s * (lensRadial[0] + s * (lensRadial[1] + s * (lensRadial[2] + s * lensRadial[3])));
    return r > 1e-6 ? n * (theta * factor / r) : n;
  }
  float above = 1.0 + r2 * (lensRadial[0] + r2 * (lensRadial[1] + r2 * lensRadial[2]));
  float below = 1.0 + r2 * (lensRadial[3] + r2 * (lensRadial[4] + r2 * lensRadial[5]));
  vec2 p = lensTangential;
  return n * (above / below) + vec2(
    2.0 * p.x * n.x * n.y + p.y * (r2 + 2.0 * n.x * n.x),
    p.x * (r2 + 2.0 * n.y * n.y) + 2.0 * p.y * n.x * n.y);
}
`

/** View axes follow three.js (y up, looking along -z), lens axes follow OpenCV. */
const PROJECTION = /* glsl */ `
#include <project_vertex>
if (lensModel != 0 && mvPosition.z < -0.01) {
  vec2 seen = distorted(vec2(mvPosition.x, -mvPosition.y) / -mvPosition.z);
  mvPosition.xy = vec2(seen.x, -seen.y) * -mvPosition.z;
  gl_Position = projectionMatrix * mvPosition;
}
`

/** Distortion is applied up to this multiple of the squared radius of the image corners. */
const MARGIN = 1.6

export class Lens {
  private readonly uniforms = {
    lensModel: { value: 0 },
    lensRadial: { value: [0, 0, 0, 0, 0, 0] },
    lensTangential: { value: [0, 0] },
    lensReach: { value: 0 },
  }

  /** Applies the lens distortion to a material. */
  applyTo<M extends Material>(material: M): M {
    const before = material.onBeforeCompile
    material.onBeforeCompile = (shader, renderer) => {
      before.call(material, shader, renderer)
      Object.assign(shader.uniforms, this.uniforms)
      shader.vertexShader = DECLARATIONS + shader.vertexShader.replace('#include <project_vertex>', PROJECTION)
    }
    const key = material.customProgramCacheKey()
    material.customProgramCacheKey = () => `${key} lens`
    return material
  }

  /** Sets the camera whose lens is applied; null for no distortion. */
  set(camera: Camera | null) {
    const { lensModel, lensRadial, lensTangential, lensReach } = this.uniforms
    if (!camera || !isDistorted(camera)) return void (lensModel.value = 0)
    const { dist, width, height } = camera
    const corners = [[0, 0], [width, 0], [0, height], [width, height]].map(([x, y]) => normalizedFromPixel(camera, x, y))
    lensReach.value = MARGIN * Math.max(...corners.map(([u, v]) => u * u + v * v))
    if (camera.distortion_model === 'fisheye') {
      lensModel.value = 2
      lensRadial.value = [dist[0], dist[1], dist[2], dist[3], 0, 0]
      return
    }
    const [k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0] = dist
    lensModel.value = 1
    lensRadial.value = [k1, k2, k3, k4, k5, k6]
    lensTangential.value = [p1, p2]
  }
}

// Round cones (two spheres and their convex hull), drawn in one call; used for bones and points.

import {
  CapsuleGeometry,
  Color,
  DynamicDrawUsage,
  Float32BufferAttribute,
  InstancedBufferAttribute,
  InstancedBufferGeometry,
  type Material,
  Mesh,
  MeshLambertMaterial,
} from 'three'
import type { Lens } from './lens'

/** A unit capsule whose vertices store their end; the shader moves each half sphere to its end of the instance. */
function capsule(segments: number) {
  const source = new CapsuleGeometry(1, 1, segments, 2 * segments)
  const position = source.getAttribute('position')
  const offsets = new Float32Array(3 * position.count)
  const ends = new Float32Array(position.count)
  for (let i = 0; i < position.count; i++) {
    const y = position.getY(i)
    ends[i] = y > 0 ? 1 : 0
    offsets.set([position.getX(i), y - Math.sign(y) * 0.5, position.getZ(i)], 3 * i)
  }
  const geometry = new InstancedBufferGeometry()
  geometry.setIndex(source.getIndex())
  geometry.setAttribute('position', new Float32BufferAttribute(offsets, 3))
  geometry.setAttribute('normal', new Float32BufferAttribute(offsets, 3))
  geometry.setAttribute('end', new Float32BufferAttribute(ends, 1))
  return geometry
}

const DECLARATIONS = /* glsl */ `
attribute float end;
attribute vec4 tail; // centre and radius, metres
attribute vec4 tip;
vec3 outwards(vec3 n) {
  vec3 axis = tip.xyz - tail.xyz;
  vec3 along = length(axis) > 1e-5 ? normalize(axis) : vec3(0.0, 1.0, 0.0);
  vec3 across = normalize(cross(along, abs(along.x) < 0.9 ? vec3(1.0, 0.0, 0.0) : vec3(0.0, 0.0, 1.0)));
  return across * n.x + along * n.y + cross(across, along) * n.z;
}
`
const NORMAL = 'vec3 objectNormal = outwards(normal);'
const POSITION = `
vec4 centre = mix(tail, tip, end);
vec3 transformed = centre.xyz + centre.w * outwards(position);
`

function withInstances<M extends Material>(material: M): M {
  material.onBeforeCompile = (shader) => {
    shader.vertexShader = (DECLARATIONS + shader.vertexShader)
      .replace('#include <beginnormal_vertex>', NORMAL)
      .replace('#include <begin_vertex>', POSITION)
  }
  material.customProgramCacheKey = () => 'round_cones'
  return material
}

/** A mesh of at most `capacity` round cones, refilled in every frame. */
export class RoundCones {
  readonly mesh: Mesh
  private readonly geometry: InstancedBufferGeometry
  private readonly tails: InstancedBufferAttribute
  private readonly tips: InstancedBufferAttribute
  private readonly colors: InstancedBufferAttribute
  private n = 0

  constructor(capacity: number, segments: number, layer: number, lens: Lens) {
    const attribute = (width: number) => {
      const made = new InstancedBufferAttribute(new Float32Array(width * capacity), width)
      made.setUsage(DynamicDrawUsage)
      return made
    }
    this.geometry = capsule(segments)
    this.geometry.setAttribute('tail', (this.tails = attribute(4)))
    this.geometry.setAttribute('tip', (this.tips = attribute(4)))
    this.geometry.setAttribute('color', (this.colors = attribute(3)))
    this.mesh = new Mesh(
      this.geometry,
      lens.applyTo(withInstances(new MeshLambertMaterial({ vertexColors: true }))),
    )
    this.mesh.layers.set(layer)
    this.mesh.frustumCulled = false
  }

  clear() {
    this.n = 0
  }

  /** Adds a cone from row `a` to row `b` of an array of points; unknown points (NaN) are skipped. */
  add(points: Float32Array, a: number, b: number, radiusA: number, radiusB: number, color: Color) {
    const [i, j] = [3 * a, 3 * b]
    this.put(points[i], points[i + 1], points[i + 2], radiusA, points[j], points[j + 1], points[j + 2], radiusB, color)
  }

  put(
    ax: number, ay: number, az: number, radiusA: number,
    bx: number, by: number, bz: number, radiusB: number,
    color: Color,
  ) {
    if (this.n >= this.tails.count || ax !== ax || bx !== bx) return
    this.tails.setXYZW(this.n, ax, ay, az, radiusA)
    this.tips.setXYZW(this.n, bx, by, bz, radiusB)
    this.colors.setXYZ(this.n, color.r, color.g, color.b)
    this.n++
  }

  /** Second ends of the added cones. */
  get ends(): [number, number, number][] {
    return Array.from({ length: this.n }, (_, i) => [this.tips.getX(i), this.tips.getY(i), this.tips.getZ(i)])
  }

  /** Uploads the added cones for the next picture. */
  show() {
    this.geometry.instanceCount = this.n
    this.mesh.visible = this.n > 0
    for (const attribute of [this.tails, this.tips, this.colors]) attribute.needsUpdate = true
  }

  dispose() {
    this.geometry.dispose()
    ;(this.mesh.material as Material).dispose()
  }
}

// People as the default body: shaped once, posed by the graphics card for every frame.

import {
  type Bone,
  BufferAttribute,
  BufferGeometry,
  Color,
  DetachedBindMode,
  Matrix4,
  MeshLambertMaterial,
  Object3D,
  Quaternion,
  Skeleton,
  SkinnedMesh,
  Sphere,
  Vector3,
} from 'three'
import { type BodyMesh, likeness, shaped } from '../data/body_mesh'
import { type Motion, type Person, N_JOINTS, UNIT_TURN } from '../data/motion'
import type { Lens } from './lens'

interface Body {
  mesh: SkinnedMesh
  bones: Object3D[]
}

export class Bodies {
  private readonly bodies: Body[]
  private readonly turn = new Quaternion()
  private readonly place = new Vector3()
  private readonly one = new Vector3(1, 1, 1)

  /** Whether the bodies are only a likeness, since the people were fitted with a body that stays where it is. */
  readonly isLikeness: boolean

  constructor(motion: Motion, mesh: BodyMesh, parent: Object3D, layer: number, lens: Lens) {
    this.isLikeness = motion.body_model?.sha256 !== mesh.sha256
    const shared = sharedGeometry(mesh)
    this.bodies = motion.people.map((person) => {
      const body = bodyOf(person, mesh, shared, this.isLikeness)
      lens.bend(body.mesh.material as MeshLambertMaterial)
      body.mesh.layers.set(layer)
      parent.add(body.mesh)
      return body
    })
  }

  /** Poses a person as they are in a row of their arrays. */
  pose(index: number, person: Person, row: number, color: Color) {
    const { mesh, bones } = this.bodies[index]
    mesh.visible = true
    ;(mesh.material as MeshLambertMaterial).color.copy(color)
    const turns = person.turns!
    for (let joint = 0; joint < N_JOINTS; joint++) {
      const [i, q] = [3 * (row * N_JOINTS + joint), 4 * (row * N_JOINTS + joint)]
      this.turn.set(turns[q], turns[q + 1], turns[q + 2], turns[q + 3])
      this.turn.set(this.turn.x / UNIT_TURN, this.turn.y / UNIT_TURN, this.turn.z / UNIT_TURN, this.turn.w / UNIT_TURN).normalize()
      bones[joint].matrixWorld.compose(this.place.fromArray(person.joints, i), this.turn, this.one)
    }
  }

  hide() {
    for (const { mesh } of this.bodies) mesh.visible = false
  }

  /** A vertex of the body as it was posed last, world metres: for the checks. */
  vertex(index: number, vertex: number): [number, number, number] {
    const { mesh } = this.bodies[index]
    mesh.skeleton.update()
    const point = new Vector3().fromBufferAttribute(mesh.geometry.getAttribute('position') as BufferAttribute, vertex)
    return mesh.applyBoneTransform(vertex, point).toArray()
  }

  dispose() {
    for (const { mesh } of this.bodies) {
      mesh.geometry.dispose()
      mesh.skeleton.dispose()
      ;(mesh.material as MeshLambertMaterial).dispose()
    }
  }
}

/** What all bodies have in common: faces, skin and, near enough, the directions of the skin. */
function sharedGeometry(mesh: BodyMesh) {
  const geometry = new BufferGeometry()
  geometry.setIndex(new BufferAttribute(mesh.faces, 1))
  geometry.setAttribute('position', new BufferAttribute(mesh.vertices, 3))
  geometry.computeVertexNormals()
  geometry.setAttribute('skinIndex', new BufferAttribute(mesh.skinJoints, 4))
  geometry.setAttribute('skinWeight', new BufferAttribute(mesh.skinWeights, 4, true))
  return geometry
}

function bodyOf(person: Person, mesh: BodyMesh, shared: BufferGeometry, isLikeness: boolean): Body {
  const at = Math.max(person.valid.indexOf(1), 0)
  const shape = isLikeness || !person.betas ? likeness(mesh, person.joints, at) : shaped(mesh, person.betas)
  const geometry = new BufferGeometry()
  geometry.setIndex(shared.getIndex())
  geometry.setAttribute('position', new BufferAttribute(shape.vertices, 3))
  for (const name of ['normal', 'skinIndex', 'skinWeight']) geometry.setAttribute(name, shared.getAttribute(name))
  const body = new SkinnedMesh(geometry, new MeshLambertMaterial())
  // The bones stand in the result's own world already: no parent of theirs turns them, and the mesh's own turn comes after.
  const bones = Array.from({ length: N_JOINTS }, () => new Object3D())
  const inverses = bones.map((_, joint) => {
    const [x, y, z] = shape.joints.subarray(3 * joint, 3 * joint + 3)
    return new Matrix4().makeTranslation(-x, -y, -z)
  })
  body.bindMode = DetachedBindMode
  body.bind(new Skeleton(bones as Bone[], inverses), new Matrix4())
  body.castShadow = true
  body.frustumCulled = false
  // Never asked for where nothing is culled, but measured vertex by vertex where it is missing.
  body.boundingSphere = new Sphere(new Vector3(), Infinity)
  body.visible = false
  return { mesh: body, bones }
}

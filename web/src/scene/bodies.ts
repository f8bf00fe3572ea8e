// People drawn with the mesh of the default body: shaped once, posed by the GPU in every frame.

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
import { type BodyMesh, scaledMeanBody, shaped } from '../data/body_mesh'
import { type Motion, type Person, N_JOINTS, QUATERNION_UNIT } from '../data/motion'
import type { Lens } from './lens'

interface Body {
  mesh: SkinnedMesh
  bones: Object3D[]
}

export class Bodies {
  private readonly bodies: Body[]
  private readonly rotation = new Quaternion()
  private readonly position = new Vector3()
  private readonly one = new Vector3(1, 1, 1)

  /** Whether the people were fitted with another body model, which the service does not publish. */
  readonly isSubstitute: boolean

  constructor(motion: Motion, mesh: BodyMesh, parent: Object3D, layer: number, lens: Lens) {
    this.isSubstitute = motion.body_model?.sha256 !== mesh.sha256
    const shared = sharedGeometry(mesh)
    this.bodies = motion.people.map((person) => {
      const body = bodyOf(person, mesh, shared, this.isSubstitute)
      lens.applyTo(body.mesh.material as MeshLambertMaterial)
      body.mesh.layers.set(layer)
      parent.add(body.mesh)
      return body
    })
  }

  /** Poses a person as in a row of the motion arrays. */
  pose(index: number, person: Person, row: number, color: Color) {
    const { mesh, bones } = this.bodies[index]
    mesh.visible = true
    ;(mesh.material as MeshLambertMaterial).color.copy(color)
    const rotations = person.rotations!
    for (let joint = 0; joint < N_JOINTS; joint++) {
      const [i, q] = [3 * (row * N_JOINTS + joint), 4 * (row * N_JOINTS + joint)]
      this.rotation.set(rotations[q], rotations[q + 1], rotations[q + 2], rotations[q + 3])
      this.rotation.set(this.rotation.x / QUATERNION_UNIT, this.rotation.y / QUATERNION_UNIT, this.rotation.z / QUATERNION_UNIT, this.rotation.w / QUATERNION_UNIT).normalize()
      bones[joint].matrixWorld.compose(this.position.fromArray(person.joints, i), this.rotation, this.one)
    }
  }

  hide() {
    for (const { mesh } of this.bodies) mesh.visible = false
  }

  /** A vertex of the posed body, world metres. Used by the browser checks. */
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

/** Geometry shared by all bodies: faces, skinning weights and, approximately, normals. */
function sharedGeometry(mesh: BodyMesh) {
  const geometry = new BufferGeometry()
  geometry.setIndex(new BufferAttribute(mesh.faces, 1))
  geometry.setAttribute('position', new BufferAttribute(mesh.vertices, 3))
  geometry.computeVertexNormals()
  geometry.setAttribute('skinIndex', new BufferAttribute(mesh.skinJoints, 4))
  geometry.setAttribute('skinWeight', new BufferAttribute(mesh.skinWeights, 4, true))
  return geometry
}

function bodyOf(person: Person, mesh: BodyMesh, shared: BufferGeometry, isSubstitute: boolean): Body {
  const at = Math.max(person.valid.indexOf(1), 0)
  const shape = isSubstitute || !person.betas ? scaledMeanBody(mesh, person.joints, at) : shaped(mesh, person.betas)
  const geometry = new BufferGeometry()
  geometry.setIndex(shared.getIndex())
  geometry.setAttribute('position', new BufferAttribute(shape.vertices, 3))
  for (const name of ['normal', 'skinIndex', 'skinWeight']) geometry.setAttribute(name, shared.getAttribute(name))
  const body = new SkinnedMesh(geometry, new MeshLambertMaterial())
  // Bone matrices are given in the world of the result. They have no parents; the transform of the mesh is applied afterwards.
  const bones = Array.from({ length: N_JOINTS }, () => new Object3D())
  const inverses = bones.map((_, joint) => {
    const [x, y, z] = shape.joints.subarray(3 * joint, 3 * joint + 3)
    return new Matrix4().makeTranslation(-x, -y, -z)
  })
  body.bindMode = DetachedBindMode
  body.bind(new Skeleton(bones as Bone[], inverses), new Matrix4())
  body.castShadow = true
  body.frustumCulled = false
  // Without it three.js would compute the bounding sphere from all vertices.
  body.boundingSphere = new Sphere(new Vector3(), Infinity)
  body.visible = false
  return { mesh: body, bones }
}

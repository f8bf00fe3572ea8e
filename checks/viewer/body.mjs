// Compares the drawn bodies with an independent linear blend skinning of `people.json`, using the body of
// `wandless body export`.

import { readFileSync } from 'node:fs'
import { inflateRawSync } from 'node:zlib'
import { check } from './browser.mjs'

const N_JOINTS = 24

/** Includes the error of the skinning weights, which are quantised to 1/255. */
const TOLERANCE_MM = 2

export async function checkBodies(page, base, job, file) {
  const body = readNpz(file)
  const people = await (await fetch(`${base}/v1/jobs/${job.id}/artifacts/people.json`)).json()
  const first = people.people.map(({ frames }) => frames[0]).reduce((a, b) => Math.min(a, b))
  let [worst, n] = [0, 0]
  for (const [index, person] of people.people.entries()) {
    for (const row of [0, Math.floor(person.frames.length / 3), person.frames.length - 1]) {
      await page.evaluate((frame) => window.wandless.seek(frame), person.frames[row] - first)
      await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))))
      const bones = posed(body, person, row)
      for (let vertex = 0; vertex < body.v_template.shape[0]; vertex += 97) {
        const drawn = await page.evaluate(([...key]) => window.wandless.bodyVertex(...key), [index, vertex])
        const expected = skinned(body, person.betas, bones, vertex)
        worst = Math.max(worst, 1000 * Math.hypot(...expected.map((c, i) => c - (drawn?.[i] ?? Infinity))))
        n++
      }
    }
  }
  check(`bodies against people.json within ${TOLERANCE_MM} mm`, n > 0 && worst <= TOLERANCE_MM, `${worst.toFixed(2)} mm over ${n} vertices`)
}

/** Rest joints, world rotations and world positions of all joints. */
function posed({ v_template, shapedirs, J_regressor, kintree_table }, person, row) {
  const n = v_template.shape[0]
  const rest = Array.from({ length: N_JOINTS }, (_, j) => {
    const joint = [0, 0, 0]
    for (let v = 0; v < n; v++) {
      const share = J_regressor.at(j * n + v)
      if (share !== 0) restVertex(v_template, shapedirs, person.betas, v).forEach((c, i) => (joint[i] += share * c))
    }
    return joint
  })
  const local = [person.global_orient[row], ...Array.from({ length: N_JOINTS - 1 }, (_, j) => person.body_pose[row].slice(3 * j, 3 * j + 3))]
  const rotations = []
  const positions = []
  for (let j = 0; j < N_JOINTS; j++) {
    const parent = j === 0 ? -1 : Number(kintree_table.at(j))
    const localRotation = rotationMatrix(local[j])
    rotations[j] = parent < 0 ? localRotation : product(rotations[parent], localRotation)
    const offset = rest[j].map((c, i) => c - (parent < 0 ? 0 : rest[parent][i]))
    positions[j] = parent < 0 ? rest[j].map((c, i) => c + person.transl[row][i]) : sum(positions[parent], times(rotations[parent], offset))
  }
  return { rest, rotations, positions }
}

function skinned({ v_template, shapedirs, weights }, betas, { rest, rotations, positions }, vertex) {
  const point = restVertex(v_template, shapedirs, betas, vertex)
  const found = [0, 0, 0]
  for (let j = 0; j < N_JOINTS; j++) {
    const weight = weights.at(vertex * N_JOINTS + j)
    if (weight === 0) continue
    const moved = sum(positions[j], times(rotations[j], point.map((c, i) => c - rest[j][i])))
    moved.forEach((c, i) => (found[i] += weight * c))
  }
  return found
}

const restVertex = (template, directions, betas, v) =>
  [0, 1, 2].map((i) => template.at(3 * v + i) + betas.reduce((s, beta, b) => s + beta * directions.at((3 * v + i) * betas.length + b), 0))

/** Rodrigues' formula. */
function rotationMatrix(axisAngle) {
  const angle = Math.hypot(...axisAngle)
  const [x, y, z] = axisAngle.map((c) => c / (angle || 1))
  const [s, c] = [Math.sin(angle), 1 - Math.cos(angle)]
  return [
    [1 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
    [c * x * y + s * z, 1 - c * (x * x + z * z), c * y * z - s * x],
    [c * x * z - s * y, c * y * z + s * x, 1 - c * (x * x + y * y)],
  ]
}

const times = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
const product = (a, b) => a.map((row) => [0, 1, 2].map((c) => row[0] * b[0][c] + row[1] * b[1][c] + row[2] * b[2][c]))
const sum = (a, b) => a.map((c, i) => c + b[i])

/** The arrays of an `.npz`, as `{shape, at(i)}`. */
function readNpz(file) {
  const bytes = readFileSync(file)
  const arrays = {}
  let at = bytes.readUInt32LE(bytes.lastIndexOf(Buffer.from('PK\x05\x06', 'latin1')) + 16)
  while (bytes.readUInt32LE(at) === 0x02014b50) {
    const [method, packed, nameLength] = [bytes.readUInt16LE(at + 10), bytes.readUInt32LE(at + 20), bytes.readUInt16LE(at + 28)]
    const local = bytes.readUInt32LE(at + 42)
    const start = local + 30 + bytes.readUInt16LE(local + 26) + bytes.readUInt16LE(local + 28)
    const content = bytes.subarray(start, start + packed)
    const name = bytes.toString('utf8', at + 46, at + 46 + nameLength).replace(/\.npy$/, '')
    arrays[name] = readNpy(method === 8 ? inflateRawSync(content) : content)
    at += 46 + nameLength + bytes.readUInt16LE(at + 30) + bytes.readUInt16LE(at + 32)
  }
  return arrays
}

function readNpy(bytes) {
  const length = bytes[6] === 1 ? bytes.readUInt16LE(8) : bytes.readUInt32LE(8)
  const start = (bytes[6] === 1 ? 10 : 12) + length
  const header = bytes.toString('latin1', start - length, start)
  const kind = /'descr': '[<|]?([a-z]\d)'/.exec(header)?.[1] ?? ''
  const shape = (/'shape': \(([^)]*)\)/.exec(header)?.[1] ?? '').split(',').filter((n) => n.trim()).map(Number)
  const readers = { f4: [4, 'readFloatLE'], f8: [8, 'readDoubleLE'], i4: [4, 'readInt32LE'], u4: [4, 'readUInt32LE'], i8: [8, 'readBigInt64LE'] }
  const [size, read] = readers[kind] ?? [1, 'readUInt8']
  return { shape, at: (i) => bytes[read](start + size * i) }
}

// Every file of a result, to be taken away.

import { artifactPath, getManifest, hasKey, request } from '../api/client'
import type { FileEntry, Job } from '../api/types'
import { button, el } from '../dom'
import { bytes } from '../format'

const MEANINGS: [RegExp, string][] = [
  [/^cameras\.json$/, 'cameras: K, R, t, uncertainty'],
  [/^people\.json$/, 'people: shape and pose, SMPL convention'],
  [/^poses3d\.json$/, "people: the body's 24 joints, metres"],
  [/^keypoints3d\.json$/, "people: the detector's points, metres"],
  [/^identities\.json$/, 'who each detection was given to'],
  [/^report\.json$/, 'figures and verdict'],
  [/^manifest\.json$/, 'every file with its digest'],
  [/^smpl\//, 'AMASS layout, 72 wide'],
  [/^smplh\//, 'AMASS layout, 156 wide'],
  [/\.glb$/, 'scene: glTF, animated'],
  [/\.usda$/, 'scene: USD'],
  [/\.bvh$/, 'motion: BVH'],
  [/\.trc$/, 'markers: TRC'],
  [/\.c3d$/, 'markers: C3D'],
  [/^colmap\//, 'cameras: COLMAP'],
  [/^stages\//, 'what this page draws'],
]

export async function filesPage(job: Job, signal: AbortSignal) {
  const manifest = await getManifest(job.id, signal)
  const own: FileEntry = { name: 'manifest.json', media_type: 'application/json', bytes: 0, sha256: '' }
  const rows = [...manifest.files, own].map((file) =>
    el('tr', {},
      el('td', {}, download(job, file.name)),
      el('td', { class: 'soft' }, MEANINGS.find(([pattern]) => pattern.test(file.name))?.[1] ?? ''),
      el('td', { class: 'number' }, file.bytes ? bytes(file.bytes) : ''),
      el('td', { class: 'digest', title: file.sha256 }, file.sha256.slice(0, 12))))
  return el('section', { class: 'files', 'aria-label': 'Files' },
    el('table', {},
      el('thead', {}, el('tr', {}, ...['File', 'Holds', 'Size', 'SHA-256'].map((name) => el('th', { scope: 'col' }, name)))),
      el('tbody', {}, ...rows)),
    el('p', { class: 'hint' }, `Made by version ${manifest.solver_version} from the input with digest ${manifest.input.sha256.slice(0, 12)}.`))
}

/** A link; with a key a request of ours, since a link cannot carry one. */
function download(job: Job, name: string) {
  const path = artifactPath(job.id, name)
  const file = name.split('/').pop() ?? name
  if (!hasKey()) return el('a', { href: path, download: file }, name)
  return button(name, async () => {
    const address = URL.createObjectURL(await (await request(path)).blob())
    el('a', { href: address, download: file }).click()
    setTimeout(() => URL.revokeObjectURL(address), 60_000)
  }, { class: 'link' })
}

// Table of the files of a result with download links.

import { artifactPath, getManifest, hasKey, request } from '../api/client'
import { type FileEntry, type Job, isStored } from '../api/types'
import { button, el } from '../dom'
import { bytes } from '../format'

const DESCRIPTIONS: [RegExp, string][] = [
  [/^cameras\.json$/, 'cameras: K, R, t, uncertainty'],
  [/^people\.json$/, 'people: shape and pose, SMPL convention'],
  [/^poses3d\.json$/, 'people: 24 body joints, metres'],
  [/^keypoints3d\.json$/, 'people: 3D keypoints of the detector convention, metres'],
  [/^identities\.json$/, 'person of each detection'],
  [/^report\.json$/, 'statistics and verdict'],
  [/^manifest\.json$/, 'list of all files with digests'],
  [/^smpl\//, 'SMPL pose parameters (72), AMASS layout'],
  [/^smplh\//, 'SMPL-H pose parameters (156), AMASS layout'],
  [/\.glb$/, 'animated scene: glTF'],
  [/\.usd[az]$/, 'scene: USD'],
  [/\.fbx$/, 'animated skeleton and mesh: FBX'],
  [/\.bvh$/, 'motion: BVH'],
  [/\.trc$/, 'markers: TRC'],
  [/\.c3d$/, 'markers: C3D'],
  [/\.angles\.csv$/, 'joint angles with standard deviations'],
  [/\.mot$/, 'joint angles: OpenSim'],
  [/\.ik\.xml$/, 'set-up of inverse kinematics: OpenSim'],
  [/^colmap\//, 'cameras: COLMAP'],
  [/^stages\//, 'data of this viewer'],
]

export async function filesPage(job: Job, signal: AbortSignal) {
  const manifest = await getManifest(job.id, signal)
  const own: FileEntry = { name: 'manifest.json', media_type: 'application/json', bytes: 0, sha256: '' }
  const rows = [...manifest.files, own].map((file) =>
    el('tr', {},
      el('td', {}, download(job, file.name)),
      el('td', { class: 'soft' }, DESCRIPTIONS.find(([pattern]) => pattern.test(file.name))?.[1] ?? ''),
      el('td', { class: 'number' }, file.bytes ? bytes(file.bytes) : ''),
      el('td', { class: 'digest', title: file.sha256 }, file.sha256.slice(0, 12))))
  return el('section', { class: 'files', 'aria-label': 'Files' },
    isStored(job) && el('p', {}, link(`/v1/jobs/${job.id}/archive`, `${job.id}.zip`, 'All files as one zip')),
    el('table', {},
      el('thead', {}, el('tr', {}, ...['File', 'Content', 'Size', 'SHA-256'].map((name) => el('th', { scope: 'col' }, name)))),
      el('tbody', {}, ...rows)),
    el('p', { class: 'hint' }, `Solver version ${manifest.solver_version}, input digest ${manifest.input.sha256.slice(0, 12)}.`))
}

/** Download link. With an API key it is a button that sends a request, because a link cannot send the key. */
function download(job: Job, name: string) {
  return link(artifactPath(job.id, name), name.split('/').pop() ?? name, name)
}

function link(path: string, file: string, text: string) {
  if (!hasKey()) return el('a', { href: path, download: file }, text)
  return button(text, async () => {
    const address = URL.createObjectURL(await (await request(path)).blob())
    el('a', { href: address, download: file }).click()
    setTimeout(() => URL.revokeObjectURL(address), 60_000)
  }, { class: 'link' })
}

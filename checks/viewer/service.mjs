// Starts a service on fresh data; simulates, uploads and solves sessions.

import { execFile, spawn } from 'node:child_process'
import { mkdtempSync, readFileSync, rmSync, writeFileSync } from 'node:fs'
import { tmpdir } from 'node:os'
import { dirname, join, resolve } from 'node:path'
import { fileURLToPath } from 'node:url'
import { promisify } from 'node:util'

const ROOT = resolve(dirname(fileURLToPath(import.meta.url)), '../..')
export const PROGRAM = process.env.WANDLESS ?? join(ROOT, 'target/release/wandless')

/** A temporary folder, deleted at exit. */
export function temporaryFolder() {
  const folder = mkdtempSync(join(tmpdir(), 'wandless-viewer-'))
  process.on('exit', () => rmSync(folder, { recursive: true, force: true }))
  return folder
}

/** Starts the service and waits for its address. */
export function startService(data) {
  const child = spawn(PROGRAM, ['serve', '--data', data, '--listen', '127.0.0.1:0'])
  process.on('exit', () => child.kill('SIGKILL'))
  return new Promise((resolve, reject) => {
    child.on('error', reject)
    child.on('exit', (code) => reject(new Error(`the service ended with ${code}`)))
    child.stdout.on('data', (text) => {
      const address = /http:\/\/[\d.:]+/.exec(String(text))
      if (address) resolve({ base: address[0], stop: () => child.kill('SIGTERM') })
    })
  })
}

/** Simulates a session; `name` replaces its name, `radius` is the distance of the cameras from the centre, m, `convention` that of the keypoints. */
export async function simulate(folder, { people, views, frames, name, radius, convention }) {
  const words = ['--people', people, '--views', views, '--frames', frames, '--seed', 1, '--out', folder]
  if (radius) words.push('--radius', radius)
  if (convention) words.push('--convention', convention)
  await promisify(execFile)(PROGRAM, ['simulate', ...words.map(String)])
  const path = join(folder, 'session.json')
  const session = JSON.parse(readFileSync(path, 'utf8'))
  if (name) writeFileSync(path, JSON.stringify({ ...session, name }))
  return folder
}

/** The session as one JSON document. */
export function asDocument(folder) {
  const session = JSON.parse(readFileSync(join(folder, 'session.json'), 'utf8'))
  const poses = session.cameras.map(({ id }) => [id, JSON.parse(readFileSync(join(folder, 'poses', `${id}.json`), 'utf8'))])
  return JSON.stringify({ ...session, poses: Object.fromEntries(poses) })
}

const post = (base, path, body) => fetch(base + path, { method: 'POST', headers: { 'Content-Type': 'application/json' }, body })

/** Uploads a document and returns the session. */
export async function uploaded(base, document) {
  const answer = await post(base, '/v1/sessions', document)
  if (!answer.ok) throw new Error(`the session was rejected: ${await answer.text()}`)
  return answer.json()
}

/** Uploads and solves a document with optional options and labels; returns the finished job. */
export async function solve(base, document, more = {}) {
  const session = await uploaded(base, document)
  const answer = await post(base, '/v1/jobs', JSON.stringify({ session: session.id, ...more }))
  if (!answer.ok) throw new Error(`the job was rejected: ${await answer.text()}`)
  let job = await answer.json()
  while (!['succeeded', 'failed', 'canceled', 'dead'].includes(job.state)) {
    job = await (await fetch(`${base}/v1/jobs/${job.id}?wait=20`)).json()
  }
  return job
}

// The whole way of a job with the types that openapi-typescript generates: node journey.js SERVER TAKE

import { readFileSync } from 'node:fs'
import { join } from 'node:path'
import createClient from 'openapi-fetch'
import type { components, paths } from './wandless'

const [server, take] = process.argv.slice(2)
const client = createClient<paths>({ baseUrl: server })

/** The data of an answer; ends the program with the problem document otherwise. */
function data<T>({ data, error }: { data?: T; error?: unknown }): NonNullable<T> {
  if (data === undefined || data === null) throw new Error(JSON.stringify(error))
  return data
}

const header = JSON.parse(readFileSync(join(take, 'session.json'), 'utf8'))
const poses = Object.fromEntries(header.cameras.map(({ id }: { id: string }) =>
  [id, JSON.parse(readFileSync(join(take, 'poses', `${id}.json`), 'utf8'))]))
const session = data(await client.POST('/v1/sessions', { body: { ...header, poses } }))
console.assert(session.cameras === header.cameras.length)
data(await client.GET('/v1/sessions/{id}/inspection', { params: { path: { id: session.id } } }))

const options: components['schemas']['Options'] = { people: 2, seed: 21, scale: { from: 'height', metres: 1.8, who: 'tallest' } }
async function followed(job: components['schemas']['Job']) {
  while (!['succeeded', 'failed', 'canceled', 'dead'].includes(job.state)) {
    job = data(await client.GET('/v1/jobs/{id}', { params: { path: { id: job.id }, query: { wait: 30 } } }))
  }
  if (job.state !== 'succeeded') throw new Error(JSON.stringify(job.error))
  return job
}

const new_job = { body: { session: session.id, options }, params: { header: { 'Idempotency-Key': 'typescript' } } }
const { id } = await followed(data(await client.POST('/v1/jobs', new_job)))
data(await client.GET('/v1/jobs/{id}/report', { params: { path: { id } } }))
const manifest = data(await client.POST('/v1/jobs/{id}/exports', { params: { path: { id } }, body: { exports: ['glb'] } }))
if (!JSON.stringify(manifest).includes('scene.glb')) throw new Error('the format was not added')
const archive = data(await client.GET('/v1/jobs/{id}/archive', { params: { path: { id } }, parseAs: 'arrayBuffer' })) as unknown as ArrayBuffer
if (new TextDecoder().decode(archive.slice(0, 2)) !== 'PK') throw new Error('the archive is not a zip')

const corrections: components['schemas']['Correction'][] = [
  { action: 'rename', person: 0, name: 'Ada' },
  { action: 'exclude_person', person: 1 },
]
const corrected = await followed(data(await client.POST('/v1/jobs', { body: { corrects: id, options: { corrections } } })))
if ('cameras' in corrected.stage_seconds) throw new Error('the corrected job did not continue from the first one')
const people = { params: { path: { id: corrected.id } } }
const found = data(await client.GET('/v1/jobs/{id}/people', people)) as unknown as { people: { id: number; name?: string }[] }
if (JSON.stringify(found.people.map(({ id, name }) => [id, name])) !== '[[0,"Ada"]]') throw new Error('the corrections were not applied')
await client.DELETE('/v1/jobs/{id}', people)

const refused = await client.POST('/v1/jobs', { body: { session: `session_${'0'.repeat(32)}` } })
if (refused.error?.code !== 'session_not_found') throw new Error('a job without a session was not refused')
await client.DELETE('/v1/jobs/{id}', { params: { path: { id } } })

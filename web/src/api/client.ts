// Requests to the service and their errors.

import type { ProvisionalScene } from '../data/provisional'
import type { Cause, Correction, Inspection, Job, Manifest, Report, Session } from './types'

/** Error of a request, with the explanation of the service if it gave one. */
export class Problem extends Error {
  readonly status: number
  readonly cause: Cause

  constructor(status: number, cause: Cause) {
    super(cause.detail)
    this.status = status
    this.cause = cause
  }
}

/** Name of the API key in the session storage, which lives as long as the tab. */
const KEY = 'wandless.key'

export function hasKey() {
  return sessionStorage.getItem(KEY) !== null
}

export function rememberKey(key: string) {
  if (key) sessionStorage.setItem(KEY, key)
  else sessionStorage.removeItem(KEY)
}

export function authorization(): Record<string, string> {
  const key = sessionStorage.getItem(KEY)
  return key ? { Authorization: `Bearer ${key}` } : {}
}

/** Sends a request. Throws a `Problem` on errors; `AbortError`s are passed on. */
export async function request(path: string, init: RequestInit = {}): Promise<Response> {
  let response: Response
  try {
    response = await fetch(path, { ...init, headers: { ...authorization(), ...init.headers } })
  } catch (error) {
    if (error instanceof DOMException && error.name === 'AbortError') throw error
    throw unreachable()
  }
  if (!response.ok && response.status !== 304) throw await problemOf(response)
  return response
}

export function unreachable() {
  return new Problem(0, {
    code: 'unreachable',
    detail: 'The service does not answer.',
    remedy: 'Check that `wandless serve` is running; this page retries automatically.',
  })
}

async function problemOf(response: Response) {
  return problemFrom(response.status, await response.text().catch(() => ''))
}

/** The problem of a response; the text may come from a proxy and need not be a problem document. */
export function problemFrom(status: number, text: string) {
  const other = { code: 'unexpected', detail: `The service answered ${status}.`, remedy: 'Try again.' }
  try {
    const cause = JSON.parse(text)
    return new Problem(status, typeof cause?.detail === 'string' ? cause : other)
  } catch {
    return new Problem(status, other)
  }
}

async function json<T>(path: string, init: RequestInit = {}): Promise<T> {
  return (await request(path, init)).json()
}

export async function listSessions(signal?: AbortSignal) {
  return (await json<{ sessions: Session[] }>('/v1/sessions?page_size=100', { signal })).sessions
}

export async function listJobs(signal?: AbortSignal) {
  return (await json<{ jobs: Job[] }>('/v1/jobs?page_size=100', { signal })).jobs
}

export const getSession = (id: string, signal?: AbortSignal) => json<Session>(`/v1/sessions/${id}`, { signal })
export const getJob = (id: string, signal?: AbortSignal) => json<Job>(`/v1/jobs/${id}`, { signal })
export const getReport = (id: string, signal?: AbortSignal) => json<Report>(`/v1/jobs/${id}/report`, { signal })
export const getManifest = (id: string, signal?: AbortSignal) => json<Manifest>(`/v1/jobs/${id}/result`, { signal })
export const getScene = (id: string, signal?: AbortSignal) => json<ProvisionalScene>(`/v1/jobs/${id}/scene`, { signal })
export const cancelJob = (id: string) => request(`/v1/jobs/${id}/cancel`, { method: 'POST' })
export const deleteJob = (id: string) => request(`/v1/jobs/${id}`, { method: 'DELETE' })
export const deleteSession = (id: string) => request(`/v1/sessions/${id}`, { method: 'DELETE' })

/** A key that no other request has. `crypto.randomUUID` is missing on pages of plain HTTP addresses other than the loopback. */
function randomKey() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, '0')).join('')
}

export function startJob(session: string, options: Record<string, unknown>) {
  const headers = { 'Content-Type': 'application/json', 'Idempotency-Key': randomKey() }
  return json<Job>('/v1/jobs', { method: 'POST', headers, body: JSON.stringify({ session, options }) })
}

/** Submits a job that corrects the people of another one, with its session and options. */
export function correctJob(corrects: string, corrections: Correction[], labels: Record<string, string>) {
  const headers = { 'Content-Type': 'application/json', 'Idempotency-Key': randomKey() }
  return json<Job>('/v1/jobs', { method: 'POST', headers, body: JSON.stringify({ corrects, options: { corrections }, labels }) })
}

/** The inspection of a session; null if the service does not offer inspections. */
export async function inspect(session: string, signal?: AbortSignal): Promise<Inspection | null> {
  try {
    return await json(`/v1/sessions/${session}/inspection`, { signal })
  } catch (error) {
    if (error instanceof Problem && error.status === 404) return null
    throw error
  }
}

/** Path of a result file; its name may contain slashes and special characters. */
export function artifactPath(job: string, name: string) {
  return `/v1/jobs/${job}/artifacts/${name.split('/').map(encodeURIComponent).join('/')}`
}

/** Content of a result file; null if the result does not contain it. */
export async function getArtifact(job: string, name: string, signal?: AbortSignal): Promise<ArrayBuffer | null> {
  try {
    return await (await request(artifactPath(job, name), { signal })).arrayBuffer()
  } catch (error) {
    if (error instanceof Problem && error.status === 404) return null
    throw error
  }
}

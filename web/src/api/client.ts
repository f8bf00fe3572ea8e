// Requests to the service, their answers and every way they fail.

import type { Cause, Inspection, Job, Manifest, Report, Session } from './types'

/** What went wrong, in the service's words where it gave any. */
export class Problem extends Error {
  readonly status: number
  readonly cause: Cause

  constructor(status: number, cause: Cause) {
    super(cause.detail)
    this.status = status
    this.cause = cause
  }
}

/** The service's key, kept for this tab only. */
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

/** A request that either answers or throws a `Problem`; `AbortError`s pass. */
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
    remedy: 'Check that `wandless serve` is running; this page tries again by itself.',
  })
}

async function problemOf(response: Response) {
  return problemFrom(response.status, await response.text().catch(() => ''))
}

/** A problem from an answer's status and text, whatever stands between us and the service. */
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
export const cancelJob = (id: string) => request(`/v1/jobs/${id}/cancel`, { method: 'POST' })
export const deleteJob = (id: string) => request(`/v1/jobs/${id}`, { method: 'DELETE' })
export const deleteSession = (id: string) => request(`/v1/sessions/${id}`, { method: 'DELETE' })

export function startJob(session: string, options: Record<string, unknown>) {
  const headers = { 'Content-Type': 'application/json', 'Idempotency-Key': crypto.randomUUID() }
  return json<Job>('/v1/jobs', { method: 'POST', headers, body: JSON.stringify({ session, options }) })
}

/** The inspection's findings, or nothing where the service has no such route. */
export async function inspect(session: string, signal?: AbortSignal): Promise<Inspection | null> {
  try {
    return await json(`/v1/sessions/${session}/inspection`, { signal })
  } catch (error) {
    if (error instanceof Problem && error.status === 404) return null
    throw error
  }
}

/** Path of a result's file; a name may hold slashes, and anything else. */
export function artifactPath(job: string, name: string) {
  return `/v1/jobs/${job}/artifacts/${name.split('/').map(encodeURIComponent).join('/')}`
}

/** A result's file as bytes; nothing where the result has no such file. */
export async function getArtifact(job: string, name: string, signal?: AbortSignal): Promise<ArrayBuffer | null> {
  try {
    return await (await request(artifactPath(job, name), { signal })).arrayBuffer()
  } catch (error) {
    if (error instanceof Problem && error.status === 404) return null
    throw error
  }
}

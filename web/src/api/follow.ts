// A job as it changes: server-sent events where the service has them, long polling where it does not.

import { Problem, request } from './client'
import { type Job, isFinal } from './types'

/** Longest hold of one question, s. */
const WAIT_SECS = 25

/** Between two tries of a service that does not answer, ms. */
const RETRY_MS = 2000

/** Between two questions while events come, ms: progress is told ten times a second, nobody reads so fast. */
const CALM_MS = 200

/** Calls `onJob` at once and at every change until the job is final or `signal` aborts; `onProblem` where a question fails. */
export async function follow(
  id: string,
  onJob: (job: Job) => void,
  onProblem: (problem: Problem | null) => void,
  signal: AbortSignal,
) {
  let tag: string | null = null
  let events: Events | null = null
  let hasEvents = true
  try {
    while (!signal.aborted) {
      try {
        const wait = hasEvents || !tag ? 0 : WAIT_SECS
        const answer: Response = await request(`/v1/jobs/${id}?wait=${wait}`, {
          headers: tag ? { 'If-None-Match': tag } : {},
          cache: 'no-store',
          signal,
        })
        onProblem(null)
        if (answer.status !== 304) {
          tag = answer.headers.get('ETag')
          const job: Job = await answer.json()
          onJob(job)
          if (isFinal(job.state)) return
        }
        if (hasEvents && !events) hasEvents = (events = await openEvents(id, signal)) !== null
        await pause(CALM_MS, signal)
        if (events && (await events.read()).done) events = null
      } catch (error) {
        if (signal.aborted) return
        if (!(error instanceof Problem)) throw error
        onProblem(error)
        if (error.status === 401 || error.status === 404) return
        events = null
        await pause(RETRY_MS, signal)
      }
    }
  } finally {
    events?.cancel().catch(() => {})
  }
}

type Events = ReadableStreamDefaultReader<Uint8Array>

/** The stream of a job's events: whatever comes on it means that the job is worth another look. Null where there is none. */
async function openEvents(id: string, signal: AbortSignal): Promise<Events | null> {
  try {
    const answer = await request(`/v1/jobs/${id}/events`, { headers: { Accept: 'text/event-stream' }, signal })
    const isStream = answer.headers.get('Content-Type')?.startsWith('text/event-stream')
    return isStream && answer.body ? answer.body.getReader() : null
  } catch (error) {
    if (error instanceof Problem && [404, 405, 406, 501].includes(error.status)) return null
    throw error
  }
}

export function pause(ms: number, signal: AbortSignal) {
  return new Promise<void>((resolve) => {
    const timer = setTimeout(resolve, ms)
    signal.addEventListener('abort', () => (clearTimeout(timer), resolve()), { once: true })
  })
}

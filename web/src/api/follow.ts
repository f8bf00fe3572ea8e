// Follows a job through the events of the service.

import { Problem, getJob, request } from './client'
import { eventsOf } from './events'
import { type Job, type Progress, isFinal } from './types'

/** Delay before a retry after a failed request, ms. */
const RETRY_MS = 2000

/** Callbacks of `follow`. */
export interface Follower {
  onJob: (job: Job) => void
  /** A log line of the job process. */
  onLog?: (line: string) => void
  /** There is a new provisional scene. */
  onScene?: () => void
  /** A connection problem; null as soon as the service answers again. */
  onProblem: (problem: Problem | null) => void
}

/** Reports a job immediately and at every change, until it is final or deleted or `signal` aborts. */
export async function follow(id: string, follower: Follower, signal: AbortSignal) {
  let last: string | null = null
  let job: Job | null = null
  const report = (now: Job) => {
    job = now
    follower.onJob(now)
  }
  while (!signal.aborted) {
    try {
      const headers: Record<string, string> = { Accept: 'text/event-stream', ...(last && { 'Last-Event-ID': last }) }
      const answer = await request(`/v1/jobs/${id}/events`, { headers, cache: 'no-store', signal })
      follower.onProblem(null)
      for await (const { name, data, id: version } of eventsOf(answer)) {
        if (signal.aborted) return
        last = version ?? last
        if (name === 'log') follower.onLog?.(String(JSON.parse(data).line))
        else if (name === 'scene') follower.onScene?.()
        else if (name === 'state') report(JSON.parse(data))
        // Progress events do not contain the times of finished stages.
        else if (name === 'progress' && job) report(await withProgress(job, JSON.parse(data), signal))
        if (job && isFinal((job as Job).state)) return
      }
    } catch (error) {
      if (signal.aborted) return
      const problem = error instanceof Problem ? error : interrupted(error)
      follower.onProblem(problem)
      if (problem.status === 401 || problem.status === 404) return
    }
    await pause(RETRY_MS, signal)
  }
}

async function withProgress(job: Job, progress: Progress, signal: AbortSignal): Promise<Job> {
  return job.progress?.stage === progress.stage ? { ...job, progress } : getJob(job.id, signal)
}

/** Wraps the error of an interrupted stream. */
function interrupted(error: unknown) {
  const detail = `The connection to the service was interrupted (${error instanceof Error ? error.message : String(error)}).`
  return new Problem(0, { code: 'interrupted', detail, remedy: 'This page retries automatically.' })
}

export function pause(ms: number, signal: AbortSignal) {
  return new Promise<void>((resolve) => {
    const timer = setTimeout(resolve, ms)
    signal.addEventListener('abort', () => (clearTimeout(timer), resolve()), { once: true })
  })
}

// A job as it changes, told by the service's events.

import { Problem, getJob, request } from './client'
import { eventsOf } from './events'
import { type Job, type Progress, isFinal } from './types'

/** Between two tries of a service that does not answer, ms. */
const RETRY_MS = 2000

/** Who listens to a job. */
export interface Follower {
  onJob: (job: Job) => void
  /** A line that the job's own process wrote. */
  onLog?: (line: string) => void
  /** Why nothing is heard; null as soon as the service answers again. */
  onProblem: (problem: Problem | null) => void
}

/** Tells of a job at once and at every change until it is final, is gone, or `signal` aborts. */
export async function follow(id: string, follower: Follower, signal: AbortSignal) {
  let last: string | null = null
  let job: Job | null = null
  const tell = (now: Job) => {
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
        else if (name === 'state') tell(JSON.parse(data))
        // A stage's time is told by the job alone.
        else if (name === 'progress' && job) tell(await withProgress(job, JSON.parse(data), signal))
        if (job && isFinal((job as Job).state)) return
      }
    } catch (error) {
      if (signal.aborted) return
      const problem = error instanceof Problem ? error : unreadable(error)
      follower.onProblem(problem)
      if (problem.status === 401 || problem.status === 404) return
    }
    await pause(RETRY_MS, signal)
  }
}

async function withProgress(job: Job, progress: Progress, signal: AbortSignal): Promise<Job> {
  return job.progress?.stage === progress.stage ? { ...job, progress } : getJob(job.id, signal)
}

/** A stream that breaks in the middle fails in the browser's own words. */
function unreadable(error: unknown) {
  const detail = `The service's answer broke off (${error instanceof Error ? error.message : String(error)}).`
  return new Problem(0, { code: 'broken_off', detail, remedy: 'This page tries again by itself.' })
}

export function pause(ms: number, signal: AbortSignal) {
  return new Promise<void>((resolve) => {
    const timer = setTimeout(resolve, ms)
    signal.addEventListener('abort', () => (clearTimeout(timer), resolve()), { once: true })
  })
}

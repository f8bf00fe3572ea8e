// The provisional scene of a running job.

import { check, checkAccess, openJobAnew, shot } from './browser.mjs'
import { drawn } from './scene.mjs'

/** Waits for the scene of the running job of the page; returns the job and its scene. */
export async function liveScene(page, base) {
  const scene = page.locator('.provisional')
  await scene.waitFor({ timeout: 90_000 })
  const id = page.url().split('/jobs/')[1].split('/')[0]
  const get = async (path) => (await fetch(`${base}/v1/jobs/${id}${path}`)).json()
  const found = { job: await get(''), scene: await get('/scene') }
  const { cameras, people, stage } = await scene.evaluate(({ dataset }) => ({ ...dataset }))
  check('cameras and people are shown while the job runs', Number(cameras) >= 3 && Number(people) >= 2, `${cameras} cameras, ${people} people after ${stage}`)
  return found
}

/** Picture of the scene; two of them are equal while it is paused. */
async function picture(page) {
  const clip = await page.locator('.provisional .stage').evaluate((stage) => {
    const { x, y, width, height } = stage.getBoundingClientRect()
    return { x, y, width, height }
  })
  return (await page.screenshot({ clip })).toString('base64')
}

/** The scene plays, pauses, and fits a phone. The job is shown as it was while it ran, so that no solve is too fast for the check. */
export async function checkProvisional(page, base, { job, scene }) {
  const events = `event: state\nid: 1\ndata: ${JSON.stringify(job)}\n\nevent: scene\ndata: ${JSON.stringify({ stage: scene.stage })}\n\n`
  await page.route('**/events', (route) => route.fulfill({ contentType: 'text/event-stream', body: events }))
  await page.route('**/scene', (route) => route.fulfill({ contentType: 'application/json', body: JSON.stringify(scene) }))
  await openJobAnew(page, base, job.id)
  const shown = page.locator('.provisional')
  await shown.waitFor()
  check('the provisional scene is named as such', /^Provisional/.test(await shown.locator('figcaption').innerText()))
  const first = await picture(page)
  await page.waitForTimeout(1000)
  check('the provisional scene plays', (await picture(page)) !== first)
  await shown.getByRole('button', { name: 'Pause' }).click()
  await drawn(page)
  const paused = await picture(page)
  await page.waitForTimeout(1000)
  check('the provisional scene can be paused', (await picture(page)) === paused)
  await shot(page, 'provisional')
  await checkAccess(page, 'provisional scene')
  const size = page.viewportSize()
  await page.setViewportSize({ width: 390, height: 844 })
  await drawn(page)
  const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)
  check('on a phone the provisional scene is not wider than the screen', overflow <= 0 && (await shown.isVisible()), `${overflow} px`)
  await shot(page, 'phone-provisional')
  await checkAccess(page, 'provisional scene on a phone')
  await page.setViewportSize(size)
  await page.unroute('**/events')
  await page.unroute('**/scene')
}

// Failed jobs, rejected results, names with HTML in them, and the content security policy.

import { join } from 'node:path'
import { check, checkAccess, openJobAnew, openPage, shot } from './browser.mjs'
import { drawn, sceneReady } from './scene.mjs'
import { asDocument, simulate, solve } from './service.mjs'

export const HOSTILE = '<img src=x onerror="window.owned=1"><b>take</b>'
const HOSTILE_CAMERA = '<svg onload="window.owned=2"> & "cam"'

/** Jobs without a result, and an unknown job. */
export async function jobsWithoutResult({ page, base, folder }) {
  const document = JSON.parse(asDocument(join(folder, 'take')))
  for (const poses of Object.values(document.poses)) for (const frame of poses.frames) frame.people = []
  const job = await solve(base, JSON.stringify({ ...document, name: 'no people' }))
  await page.goto(`${base}/#/jobs/${job.id}`)
  await checkExplained(page, 'failed', 'a failed job', job.error?.code)
  const dead = { ...job, state: 'dead', error: { code: 'crashed', detail: 'The job process crashed three times.', remedy: 'Submit the session again with fewer frames, or contact the operator.' } }
  await page.route('**/events', (route) => route.fulfill({ contentType: 'text/event-stream', body: `event: state\nid: 1\ndata: ${JSON.stringify(dead)}\n\n` }))
  await openJobAnew(page, base, job.id)
  await page.getByText('The job crashed three times').waitFor()
  await checkExplained(page, 'dead', 'a crashed job')
  await page.unroute('**/events')
  await page.goto(`${base}/#/jobs/job_00000000000000000000000000000000`)
  await page.getByRole('heading', { name: 'This job does not exist' }).waitFor()
  await checkExplained(page, 'no-such-job', 'an unknown job')
}

/** A rejected result shows its verdict beside the scene and in the report. */
export async function rejectedResult({ page, base, job }) {
  const reason = 'the orientation sigma of cam02 is 3.1 degrees: it shares no people with other cameras; move it closer to the others'
  const reject = async (route) => {
    const report = await (await route.fetch()).json()
    await route.fulfill({ json: { ...report, quality: { verdict: 'reject', reasons: [reason, 'half of all detections were rejected'] } } })
  }
  await page.route('**/report', reject)
  await openJobAnew(page, base, job.id)
  await sceneReady(page)
  await page.locator('.quality').getByText('do not use').waitFor()
  await shot(page, 'rejected-scene')
  await checkAccess(page, 'scene of a rejected result')
  await page.getByRole('link', { name: 'Report' }).click()
  await page.getByText('Do not use this result.').waitFor()
  check('a rejected result shows its verdict, reasons and remedies', await page.getByText('move it closer').isVisible())
  await shot(page, 'rejected-report')
  await checkAccess(page, 'report of a rejected result')
  await page.unroute('**/report')
}

async function checkExplained(page, name, what, figure = '') {
  await page.locator('.job-body .notice.bad').waitFor()
  const text = await page.locator('.job-body').innerText()
  check(`${what} is explained, with a remedy`, /What to do/.test(text), figure)
  await shot(page, name)
  await checkAccess(page, what)
}

export async function checkEscaped(page, what) {
  const found = await page.evaluate(() => ({ owned: window.owned, strange: document.querySelectorAll('main img, main svg[onload], main b').length }))
  check(`${what} with HTML is shown as text`, found.owned === undefined && found.strange === 0)
}

export async function hostileNames({ page, base, folder }) {
  const session = await simulate(join(folder, 'hostile'), { people: 2, views: 3, frames: 60, name: HOSTILE })
  const document = JSON.parse(asDocument(session))
  const [camera] = document.cameras
  document.poses[HOSTILE_CAMERA] = document.poses[camera.id]
  delete document.poses[camera.id]
  camera.id = HOSTILE_CAMERA
  // The key of a label may not have `=`; what is left is markup still.
  const job = await solve(base, JSON.stringify(document), { labels: { [HOSTILE.slice(0, 40).replaceAll('=', '')]: HOSTILE } })
  await page.goto(`${base}/#/`)
  await page.getByRole('link', { name: HOSTILE }).first().waitFor()
  await checkEscaped(page, "a session's name")
  await shot(page, 'hostile-home')
  await page.goto(`${base}/#/jobs/${job.id}`)
  await sceneReady(page)
  await page.getByRole('button', { name: `Look through ${HOSTILE_CAMERA}` }).click()
  await drawn(page)
  await checkEscaped(page, "a camera's name")
  await shot(page, 'hostile-scene')
  for (const tab of ['Report', 'Files']) {
    await page.getByRole('link', { name: tab }).click()
    await page.locator('table').first().waitFor()
    await checkEscaped(page, `a name on the page ${tab}`)
    await shot(page, `hostile-${tab.toLowerCase()}`)
  }
}

/** The content security policy blocks injected scripts and handlers. */
export async function policy({ browser, base }) {
  const answer = await fetch(base)
  const rules = answer.headers.get('content-security-policy') ?? ''
  check('the policy forbids inline scripts', /default-src 'none'/.test(rules) && !/unsafe/.test(rules), rules.split(';')[1]?.trim())
  const other = await openPage(browser, { colorScheme: 'dark', isPolicyTried: true })
  await other.goto(base)
  await other.evaluate(() => {
    const script = document.createElement('script')
    script.textContent = 'window.owned = 3'
    const image = document.createElement('div')
    image.innerHTML = '<img src="x" onerror="window.owned = 4">'
    document.body.append(script, image)
  })
  await other.waitForTimeout(500)
  check('injected scripts and handlers do not run', (await other.evaluate(() => window.owned)) === undefined)
  await other.context().close()
}

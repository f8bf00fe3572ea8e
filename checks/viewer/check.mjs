// The whole check, in the order of its README.

import { readFileSync } from 'node:fs'
import { join } from 'node:path'
import { check, checkAccess, failed, hasBrowser, openBrowser, openPage, shot } from './browser.mjs'
import { checkFirstView, checkPlay, checkProjection, sceneReady } from './scene.mjs'
import { asDocument, simulate, solve, startService, temporaryFolder } from './service.mjs'

if (!hasBrowser()) {
  console.log('skipped: there is no Chromium (apt-get install chromium, or set CHROMIUM)')
  process.exit(0)
}
const isLong = process.argv.includes('--long')
const minutesAt = process.argv.indexOf('--minutes')
const minutes = minutesAt > 0 ? Number(process.argv[minutesAt + 1]) : isLong ? 5 : 0.2
const HOSTILE = '<img src=x onerror="document.title=\'owned\'"><b>take</b>'

const folder = temporaryFolder()
const service = await startService(folder)
const { base } = service
const browser = await openBrowser()
const page = await openPage(browser)

await noJobs()
await rejectedUpload()
const job = await dropAndSolve()
await scene(job)
await report()
await files(job)
await cancelSecond()
await failedJob()
await hostileNames()
await wrongKey(job)
await largeTake()
await deadServer()
await browser.close()
process.exit(failed() ? 1 : 0)

async function noJobs() {
  await page.goto(base)
  await page.getByText('No jobs yet.').waitFor()
  await shot(page, 'home-empty')
  await checkAccess(page, 'no jobs')
}

/** Drops a file on the window as a mouse would. */
async function drop(name, text) {
  const transfer = await page.evaluateHandle(([name, text]) => {
    const transfer = new DataTransfer()
    transfer.items.add(new File([text], name))
    return transfer
  }, [name, text])
  await page.dispatchEvent('.drop', 'dragover', { dataTransfer: transfer })
  await page.dispatchEvent('.drop', 'drop', { dataTransfer: transfer })
}

async function rejectedUpload() {
  await drop('broken.json', '{"name": "broken"}')
  const notice = page.locator('.side .notice')
  await notice.waitFor()
  const text = await notice.innerText()
  check('a rejected upload says what and what to do', /not accepted/.test(text) && /What to do/.test(text))
  await shot(page, 'upload-rejected')
  await checkAccess(page, 'rejected upload')
}

async function dropAndSolve() {
  const session = await simulate(join(folder, 'take'), { people: 3, views: 5, frames: 300 })
  await drop('take.json', asDocument(session))
  await page.getByRole('button', { name: 'Start', exact: true }).waitFor()
  await page.getByText('Files to write beside the JSON').click()
  await page.getByLabel('glb').check()
  await shot(page, 'start')
  await checkAccess(page, 'start of a job')
  await page.getByRole('button', { name: 'Start', exact: true }).click()
  await page.locator('.job-page progress').waitFor()
  await shot(page, 'solving')
  await checkAccess(page, 'solving')
  await sceneReady(page)
  check('a dropped session is solved and shown', true)
  const id = page.url().split('/jobs/')[1].split('/')[0]
  return (await fetch(`${base}/v1/jobs/${id}`)).json()
}

async function scene(job) {
  const fresh = await openPage(browser)
  await checkFirstView(fresh, base, job, '300 frames')
  await fresh.context().close()
  await page.evaluate(() => window.wandless.seek(120))
  await page.waitForTimeout(500)
  await shot(page, 'scene')
  await checkAccess(page, 'scene')
  await page.getByRole('slider', { name: 'Frame' }).fill('77')
  check('scrubbing moves the scene', (await page.evaluate(() => window.wandless.frame())) === 77)
  await page.getByRole('button', { name: 'Look through cam01' }).click()
  await page.getByText(/median distance/).waitFor()
  check('looking through a camera shows its detections', await page.locator('canvas.overlay').isVisible())
  await shot(page, 'through')
  await checkAccess(page, 'through a camera')
  await checkProjection(page, base, job)
  await page.keyboard.press('Escape')
  await page.keyboard.press('v')
  await page.waitForTimeout(400)
  await shot(page, 'compare')
  await page.keyboard.press('v')
  await page.keyboard.press('?')
  await checkAccess(page, 'list of keys')
  await page.keyboard.press('Escape')
  await page.getByRole('button', { name: 'Light' }).click()
  await page.waitForTimeout(400)
  await shot(page, 'scene-light')
  await checkAccess(page, 'scene, light')
  await page.getByRole('button', { name: 'Dark' }).click()
  await checkPlay(page, isLong ? 0.2 : minutes, '300 frames, 3 people')
}

async function report() {
  await page.getByRole('link', { name: 'Report' }).click()
  await page.locator('.chart').first().waitFor()
  check('the report draws its charts', (await page.locator('.chart').count()) === 4)
  await shot(page, 'report')
  await checkAccess(page, 'report')
}

async function files(job) {
  await page.getByRole('link', { name: 'Files' }).click()
  await page.getByRole('link', { name: 'cameras.json' }).waitFor()
  await shot(page, 'files')
  await checkAccess(page, 'files')
  const manifest = await (await fetch(`${base}/v1/jobs/${job.id}/result`)).json()
  const wanted = ['cameras.json', manifest.files.map(({ name }) => name).find((name) => name.endsWith('.glb'))]
  for (const name of wanted) {
    const [download] = await Promise.all([page.waitForEvent('download'), page.getByRole('link', { name, exact: true }).click()])
    const bytes = readFileSync(await download.path())
    const expected = manifest.files.find((file) => file.name === name).bytes
    check(`${name} is downloaded whole`, bytes.length === expected, `${bytes.length} bytes`)
  }
}

async function cancelSecond() {
  await page.goto(`${base}/#/`)
  await page.getByRole('button', { name: /^Solve/ }).first().click()
  await page.getByRole('button', { name: 'Start', exact: true }).click()
  await page.getByRole('button', { name: 'Cancel' }).click()
  await page.getByRole('heading', { name: 'Canceled' }).waitFor({ timeout: 5000 })
  check('a second job is canceled', true)
  await shot(page, 'canceled')
  await checkAccess(page, 'canceled job')
}

async function failedJob() {
  const document = JSON.parse(asDocument(join(folder, 'take')))
  for (const poses of Object.values(document.poses)) for (const frame of poses.frames) frame.people = []
  const job = await solve(base, JSON.stringify({ ...document, name: 'nobody' }))
  await page.goto(`${base}/#/jobs/${job.id}`)
  await page.locator('.notice.bad').waitFor()
  const text = await page.locator('.job-body').innerText()
  check('a failed job says what and what to do', job.state === 'failed' && /What to do/.test(text), job.error?.code)
  await shot(page, 'failed')
  await checkAccess(page, 'failed job')
}

async function hostileNames() {
  const session = await simulate(join(folder, 'hostile'), { people: 2, views: 3, frames: 60, name: HOSTILE })
  const job = await solve(base, asDocument(session))
  await page.goto(`${base}/#/`)
  await page.getByRole('link', { name: HOSTILE }).first().waitFor()
  await page.goto(`${base}/#/jobs/${job.id}/files`)
  await page.getByRole('heading', { name: HOSTILE }).waitFor()
  check('a name with HTML is text', (await page.locator('img').count()) === 0 && (await page.title()) !== 'owned')
  await shot(page, 'hostile')
}

/** The service takes no keys yet where it stands here; a proxy that wants one answers so. */
async function wrongKey(job) {
  const other = await openPage(browser, 'light')
  const problem = { type: 'about:blank', title: 'Unauthorized', status: 401, code: 'unauthorized', detail: 'The key is not known.', remedy: 'Ask the operator for a key.' }
  await other.route('**/v1/**', async (route) => {
    const isRight = route.request().headers().authorization === 'Bearer right'
    if (isRight) await route.continue()
    else await route.fulfill({ status: 401, contentType: 'application/problem+json', body: JSON.stringify(problem) })
  })
  await other.goto(`${base}/#/jobs/${job.id}/files`)
  await other.getByLabel('API key').fill('wrong')
  await checkAccess(other, 'key asked for')
  await other.getByRole('button', { name: 'Use this key' }).click()
  await other.getByText('does not accept this key').waitFor()
  check('a wrong key is told', true)
  await shot(other, 'wrong-key')
  await other.getByLabel('API key').fill('right')
  await other.getByRole('button', { name: 'Use this key' }).click()
  await other.getByRole('button', { name: 'cameras.json' }).waitFor()
  check('the right key opens the page', true)
  await other.context().close()
}

async function largeTake() {
  if (!isLong) return
  const session = await simulate(join(folder, 'large'), { people: 5, views: 5, frames: 1500 })
  const job = await solve(base, asDocument(session))
  const fresh = await openPage(browser)
  await checkFirstView(fresh, base, job, '1,500 frames')
  await checkPlay(fresh, minutes, '1,500 frames, 5 people')
  await shot(fresh, 'large')
  await fresh.context().close()
}

/** The page is open when the service dies. */
async function deadServer() {
  await page.goto(`${base}/#/`)
  await page.locator('.job').first().waitFor()
  service.stop()
  await page.getByText('The service does not answer.').waitFor({ timeout: 20_000 })
  check('a dead server is told', true)
  await shot(page, 'dead-server')
  await checkAccess(page, 'dead server')
}

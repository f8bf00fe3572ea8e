// All viewer checks, in the order of the README.

import { execFileSync } from 'node:child_process'
import { readFileSync } from 'node:fs'
import { join } from 'node:path'
import { checkBodies } from './body.mjs'
import { check, checkAccess, failed, hasBrowser, openBrowser, openJobAnew, openPage, shot } from './browser.mjs'
import { checkCorrections, checkCurvesAndZip, checkLinks, checkPhone } from './corrections.mjs'
import { checkKeys } from './keys.mjs'
import { LENSES, throughLenses } from './lenses.mjs'
import { checkProvisional, liveScene } from './provisional.mjs'
import { checkFingers, checkFirstView, checkLens, checkPlay, checkProjection, drawn, sceneReady } from './scene.mjs'
import { PROGRAM, asDocument, simulate, solve, startService, temporaryFolder, uploaded } from './service.mjs'
import { HOSTILE, rejectedResult, hostileNames, jobsWithoutResult, policy, checkEscaped } from './states.mjs'

if (!hasBrowser()) {
  console.log('SKIPPED: the viewer is not checked because Chromium is missing (apt-get install chromium, or set CHROMIUM)')
  process.exit(0)
}
const isLong = process.argv.includes('--long')
const isShort = process.argv.includes('--short')
const minutesAt = process.argv.indexOf('--minutes')
const minutes = minutesAt > 0 ? Number(process.argv[minutesAt + 1]) : 5

const folder = temporaryFolder()
const service = await startService(join(folder, 'data'))
const { base } = service
if ((await (await fetch(base)).text()).includes('without its web viewer')) {
  console.log('SKIPPED: the viewer is not checked because the program was built without it')
  process.exit(0)
}
const browser = await openBrowser()
const page = await openPage(browser)
const start = Date.now()

await noJobs()
await rejectedUpload()
const job = await dropAndSolve()
await scene()
await fingers()
await report()
await files()
await checkCurvesAndZip({ page, base, job })
await checkLinks({ browser, base, job })
await checkPhone({ browser, base, job })
await checkCorrections({ page, base, job })
await cancelLongJob()
await rejectedResult({ page, base, job })
await jobsWithoutResult({ page, base, folder })
await hostileNames({ page, base, folder })
await policy({ browser, base })
if (!isShort) {
  await lenses()
  await otherBody()
  await checkKeys(browser, join(folder, 'keys'), join(folder, 'take'))
}
if (isLong) await largeTake()
await stoppedService()
await browser.close()
console.log(`${failed() ? 'FAILED' : 'passed'} in ${((Date.now() - start) / 1000).toFixed(0)} s; screenshots in shots/`)
process.exit(failed() ? 1 : 0)

async function noJobs() {
  await page.goto(base)
  await page.getByText('No jobs yet.').waitFor()
  await shot(page, 'home-empty')
  await checkAccess(page, 'no jobs')
}

/** Drops a file on the window. */
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
  await drop(`${HOSTILE}.json`, '{"name": "broken"}')
  const notice = page.locator('.side .notice')
  await notice.waitFor()
  const text = await notice.innerText()
  check('a rejected upload is explained, with a remedy', /was rejected/.test(text) && /What to do/.test(text))
  await checkEscaped(page, "a dropped file's name")
  await shot(page, 'upload-rejected')
  await checkAccess(page, 'rejected upload')
}

async function dropAndSolve() {
  const size = isShort ? { people: 2, views: 3, frames: 120 } : { people: 3, views: 5, frames: 300 }
  const session = await simulate(join(folder, 'take'), size)
  await drop('take.json', asDocument(session))
  await page.getByRole('button', { name: 'Start', exact: true }).waitFor()
  await page.getByText(/Expected solve time/).waitFor()
  check('the inspection is shown before the start', true)
  await page.getByText('Export formats in addition to JSON').click()
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

async function scene() {
  if (!isShort) await checkFirstView(() => openPage(browser), base, job, '300 frames')
  await page.evaluate(() => window.wandless.seek(80))
  await drawn(page)
  await shot(page, 'scene')
  await checkAccess(page, 'scene')
  await page.getByRole('slider', { name: 'Frame' }).fill('77')
  check('scrubbing moves the scene', (await page.evaluate(() => window.wandless.frame())) === 77)
  // Marks that follow each other closely count as one: in a short take all may belong to one that begins earlier.
  await page.getByRole('button', { name: 'Previous mark' }).click()
  check('the previous mark is one click away', (await page.evaluate(() => window.wandless.frame())) < 77)
  await page.getByRole('button', { name: /^Person 0/ }).click()
  await page.getByText('Bone length variation').waitFor()
  await checkAccess(page, 'a selected person')
  await shot(page, 'person')
  await through()
  await sideBySide()
  await page.keyboard.press('?')
  await shot(page, 'keys')
  await checkAccess(page, 'list of keys')
  await page.keyboard.press('Escape')
  await page.getByRole('button', { name: 'Light' }).click()
  await drawn(page)
  await shot(page, 'scene-light')
  await checkAccess(page, 'scene, light')
  await page.getByRole('button', { name: 'Dark' }).click()
  const body = join(folder, 'body.npz')
  execFileSync(PROGRAM, ['body', 'export', '--out', body])
  await checkBodies(page, base, job, body)
  await checkPlay(page, 0.15, `${isShort ? 120 : 300} frames`)
}

async function through() {
  await page.getByRole('button', { name: 'Look through cam01' }).click()
  await page.getByText(/detections.* median/).waitFor()
  check('looking through a camera shows its detections', await page.locator('canvas.overlay').isVisible())
  await drawn(page)
  await shot(page, 'through')
  await checkAccess(page, 'through a camera')
  await checkProjection(page, base, job, 'ideal lens')
  await page.keyboard.press('v')
  await page.getByText('Raw: detected').waitFor()
  await drawn(page)
  await shot(page, 'through-compared')
  await checkAccess(page, 'raw and denoised through a camera')
  await page.keyboard.press('v')
  await page.keyboard.press('Escape')
}

async function sideBySide() {
  for (const [name, text] of [['cleaning', 'Denoised: repaired'], ['body', 'Fitted body']]) {
    await page.keyboard.press('v')
    await page.getByText(text).waitFor()
    await drawn(page)
    await shot(page, `compared-${name}`)
    await checkAccess(page, `side by side, ${name}`)
  }
  check('raw and denoised are shown side by side', await page.evaluate(() => window.wandless.hasDetections()))
  await page.keyboard.press('v')
}

async function report() {
  await page.getByRole('link', { name: 'Report' }).click()
  await page.locator('.chart').first().waitFor()
  check('the report draws its charts', (await page.locator('.chart').count()) === 7)
  await shot(page, 'report')
  await checkAccess(page, 'report')
  const pdf = await page.pdf({ format: 'A4', path: undefined })
  const pages = pdf.toString('latin1').match(/\/Type\s*\/Page\b/g)?.length ?? 0
  await page.emulateMedia({ media: 'print' })
  const isHidden = !(await page.getByRole('link', { name: 'Scene' }).isVisible())
  await shot(page, 'report-print')
  await page.emulateMedia({ media: null })
  check('the report prints without navigation', pages >= 1 && pages <= 4 && isHidden, `${pages} pages of A4`)
  await page.getByRole('button', { name: 'Light' }).click()
  await checkAccess(page, 'report, light')
  await shot(page, 'report-light')
  await page.getByRole('button', { name: 'Dark' }).click()
}

async function files() {
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

/** Cancels and deletes a long job. */
async function cancelLongJob() {
  const long = await simulate(join(folder, 'long'), { people: 4, views: 5, frames: 1200, name: 'long take' })
  await uploaded(base, asDocument(long))
  await page.goto(`${base}/#/`)
  await page.getByRole('button', { name: 'Solve long take' }).click()
  await page.getByRole('button', { name: 'Start', exact: true }).click()
  await page.locator('.job-page .state-running').waitFor()
  const live = await liveScene(page, base)
  await page.goto(`${base}/#/`)
  const row = page.locator('.job', { hasText: 'long take' })
  await row.locator('progress').waitFor()
  const progressText = async () => (await row.locator('.job-progress').innerText()).trim()
  const before = await progressText()
  await page.waitForFunction((before) => document.querySelector('.job-progress')?.innerText.trim() !== before, before, { timeout: 20_000 })
  check('the list updates the progress of a job', true)
  await shot(page, 'home-running')
  await checkAccess(page, 'list with a running job')
  await row.getByRole('link').click()
  await page.getByRole('button', { name: 'Cancel' }).click()
  await page.getByRole('heading', { name: 'Canceled' }).waitFor({ timeout: 10_000 })
  check('a running job is canceled', true)
  check('the provisional scene ends with the job', (await page.locator('.provisional').count()) === 0)
  await checkProvisional(page, base, live)
  await openJobAnew(page, base, live.job.id)
  await page.getByRole('heading', { name: 'Canceled' }).waitFor({ timeout: 10_000 })
  await shot(page, 'canceled')
  await checkAccess(page, 'canceled job')
  await page.getByRole('button', { name: 'Delete' }).click()
  await page.getByRole('button', { name: 'Keep it' }).waitFor()
  await checkAccess(page, 'confirmation of a deletion')
  await page.locator('dialog').getByRole('button', { name: 'Delete' }).click()
  await page.getByRole('heading', { name: 'Jobs', exact: true }).waitFor()
  await page.waitForFunction(() => ![...document.querySelectorAll('.job')].some((one) => one.textContent.includes('long take')))
  check('a job is deleted', true)
}

/** A session whose detector reports hands. */
async function fingers() {
  const size = { people: 2, views: 4, frames: 90, convention: 'coco_wholebody133', name: 'hands' }
  const job = await solve(base, asDocument(await simulate(join(folder, 'hands'), size)))
  const fresh = await openPage(browser)
  await fresh.goto(`${base}/#/jobs/${job.id}`)
  await sceneReady(fresh)
  await checkFingers(fresh, base, job)
  await shot(fresh, 'fingers')
  await fresh.context().close()
}

async function lenses() {
  // Cameras so near that people reach the edges of the images, where lenses bend most.
  const near = { people: 3, views: 5, frames: 240, radius: 2.5, name: 'three lenses' }
  const session = throughLenses(await simulate(join(folder, 'lenses'), near))
  const job = await solve(base, asDocument(session))
  await page.goto(`${base}/#/jobs/${job.id}`)
  await sceneReady(page)
  await checkProjection(page, base, job, 'OpenCV-5, rational-8 and fisheye-4')
  for (const key of ['b', 's', 'c', 't', 'n']) await page.keyboard.press(key)
  for (const [i, { distortion_model }] of LENSES.entries()) {
    await page.keyboard.press(String(i + 1))
    await drawn(page)
    await checkLens(page, base, job, i, distortion_model ?? 'polynomial')
    for (const key of ['b', 's']) await page.keyboard.press(key)
    await drawn(page)
    await shot(page, `lens-${distortion_model ?? 'polynomial'}`)
    for (const key of ['b', 's']) await page.keyboard.press(key)
  }
}

/** The same session, solved with a registered body. */
async function otherBody() {
  const data = join(folder, 'data')
  const file = join(folder, 'body.npz')
  execFileSync(PROGRAM, ['body', 'add', 'studio', file, '--data', data])
  const job = await solve(base, asDocument(join(folder, 'take')), { options: { body: 'studio' } })
  const asked = []
  page.on('request', (request) => asked.push(new URL(request.url()).pathname))
  await openJobAnew(page, base, job.id)
  await sceneReady(page)
  await page.getByText(/never leaves the service/).waitFor()
  const names = (await (await fetch(`${base}/v1/jobs/${job.id}/result`)).json()).files.map(({ name }) => name)
  check('people of a registered body are drawn as the default body, with a note', job.state === 'succeeded' && !names.some((name) => /bod(y|ies)/.test(name)),
    asked.filter((path) => path.endsWith('.bin')).map((path) => path.split('/').pop()).join(', '))
  await shot(page, 'other-body')
  await checkAccess(page, 'scene of a registered body')
}

async function largeTake() {
  const session = await simulate(join(folder, 'large'), { people: 5, views: 5, frames: 1500 })
  const job = await solve(base, asDocument(session))
  await checkFirstView(() => openPage(browser), base, job, '1,500 frames, 5 people, 5 cameras')
  const fresh = await openPage(browser)
  await fresh.goto(`${base}/#/jobs/${job.id}`)
  await sceneReady(fresh)
  await checkPlay(fresh, minutes, '1,500 frames, 5 people')
  await shot(fresh, 'large')
  await fresh.context().close()
}

/** The service stops while the page is open. */
async function stoppedService() {
  await page.goto(`${base}/#/`)
  await page.locator('.job').first().waitFor()
  await shot(page, 'home')
  service.stop()
  await page.getByText('The service does not answer.').waitFor({ timeout: 20_000 })
  check('a stopped service is reported', /What to do/.test(await page.locator('.banner').innerText()))
  await shot(page, 'stopped-service')
  await checkAccess(page, 'stopped service')
}

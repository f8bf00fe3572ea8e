// Corrections in the browser, links to a moment, footage behind the overlay, joint curves, a phone.

import { checkAccess, check, openPage, shot } from './browser.mjs'
import { drawn, sceneReady } from './scene.mjs'

/** A picture of one colour. */
const PNG = Buffer.from(
  'iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mP8z8BQDwAEhQGAhKmMIQAAAABJRU5ErkJggg==', 'base64')

const person = (page, id) => page.getByRole('button', { name: new RegExp(`^Person ${id}`) })

/** Edits, undoes, and solves a job again with a name and without a person. */
export async function checkCorrections({ page, base, job }) {
  await page.goto(`${base}/#/jobs/${job.id}`)
  await sceneReady(page)
  await page.locator('summary', { hasText: 'Corrections' }).click()
  await person(page, 0).click()
  await page.evaluate(() => window.wandless.seek(60))
  await drawn(page)
  await page.getByRole('button', { name: 'Split at frame 60' }).click()
  await page.getByRole('button', { name: 'Name…' }).click()
  await page.getByRole('textbox', { name: 'Name of the person' }).fill('Ada <b>')
  await checkAccess(page, 'name of a person')
  await page.getByRole('button', { name: 'Add' }).click()
  check('corrections are listed', (await page.locator('.corrections li').count()) === 2)
  await page.getByRole('button', { name: 'Undo' }).click()
  await page.getByRole('button', { name: 'Undo' }).click()
  check('undo removes the last correction', (await page.locator('.corrections li').count()) === 0)
  check('without a change nothing is solved again', await page.getByRole('button', { name: 'Solve again' }).last().isDisabled())
  await page.getByRole('button', { name: 'Name…' }).click()
  await page.getByRole('textbox', { name: 'Name of the person' }).fill('Ada <b>')
  await page.getByRole('button', { name: 'Add' }).click()
  await person(page, 1).click()
  await page.getByRole('button', { name: 'Exclude person' }).click()
  await page.getByRole('button', { name: 'Exclude frames…' }).click()
  await page.getByLabel('First frame').fill('0')
  await page.getByLabel('Last frame').fill('3')
  await page.getByRole('button', { name: 'Add' }).click()
  await shot(page, 'corrections')
  await checkAccess(page, 'corrections')
  // The last correction concerns a person that is left out: the job states why it cannot be applied.
  await page.locator('.correction-box').getByRole('button', { name: 'Solve again' }).click()
  await page.getByText(/person 1 was removed/).waitFor({ timeout: 60_000 })
  check('a correction that cannot be applied is explained', true)
  await shot(page, 'corrections-refused')
  await page.goto(`${base}/#/jobs/${job.id}`)
  await sceneReady(page)
  await page.locator('summary', { hasText: 'Corrections' }).click()
  await person(page, 0).click()
  await page.getByRole('button', { name: 'Name…' }).click()
  await page.getByRole('textbox', { name: 'Name of the person' }).fill('Ada <b>')
  await page.getByRole('button', { name: 'Add' }).click()
  await person(page, 1).click()
  await page.getByRole('button', { name: 'Exclude person' }).click()
  await page.locator('.correction-box').getByRole('button', { name: 'Solve again' }).click()
  await page.waitForURL((url) => /jobs\/job_/.test(url.hash) && !url.hash.includes(job.id))
  await sceneReady(page)
  await page.getByRole('button', { name: 'Ada <b>' }).waitFor()
  check('a person that is left out is gone', (await person(page, 1).count()) === 0)
  await page.locator('summary', { hasText: 'Before and after' }).click()
  const changed = page.locator('.difference tr.is-changed', { hasText: 'Person 1' })
  await changed.waitFor()
  check('before and after are compared', /none$/.test((await changed.innerText()).trim()))
  await shot(page, 'corrections-solved')
  await checkAccess(page, 'corrected result')
}

/** A link opens the frame, camera and person that it names. */
export async function checkLinks({ browser, base, job }) {
  const page = await openPage(browser)
  await page.context().grantPermissions(['clipboard-read', 'clipboard-write'])
  await page.goto(`${base}/#/jobs/${job.id}/scene?frame=42&camera=cam01&person=0`)
  await sceneReady(page)
  await page.locator('.camera-line strong', { hasText: 'cam01' }).waitFor()
  const frame = () => page.evaluate(() => window.wandless.frame())
  check('a link opens its frame, camera and person',
    (await frame()) === 42 && (await person(page, 0).getAttribute('aria-pressed')) === 'true')
  await page.getByRole('button', { name: 'Copy link' }).click()
  await page.getByText('link copied').waitFor()
  const copied = await page.evaluate(() => navigator.clipboard.readText())
  check('the copied link names the same', /frame=42&camera=cam01&person=0$/.test(copied), copied.split('#')[1])
  await page.evaluate(() => (location.hash = location.hash.replace('frame=42', 'frame=7')))
  await page.waitForFunction(() => window.wandless.frame() === 7)
  check('another link to the same job moves the scene', true)
  await footage(page)
  await page.context().close()
}

/** An image from the disk lies behind the overlay, where the camera's picture is; nothing is sent. */
async function footage(page) {
  const sent = []
  page.on('request', (request) => request.method() !== 'GET' && sent.push(request.url()))
  const files = ['10.png', '9.png', '8.png'].map((name) => ({ name, mimeType: 'image/png', buffer: PNG }))
  await page.locator('.footage-bar input[type=file]').setInputFiles(files)
  await page.evaluate(() => window.wandless.seek(2))
  const picture = page.locator('.footage img')
  await picture.waitFor()
  await drawn(page)
  const [shown, wanted] = await page.evaluate(() => {
    const { left, top, width, height } = document.querySelector('.footage').getBoundingClientRect()
    const stage = document.querySelector('.stage').getBoundingClientRect()
    const camera = 1
    const part = window.wandless.pictureOf(camera)
    return [[left - stage.left, top - stage.top, width, height], [part.left, part.top, part.width, part.height]]
  })
  check('footage lies where the image of the camera is', shown.every((value, i) => Math.abs(value - wanted[i]) < 1))
  await shot(page, 'footage')
  await checkAccess(page, 'footage')
  await page.evaluate(() => window.wandless.seek(5))
  await drawn(page)
  check('frames without a picture show none', await picture.isHidden())
  check('footage is not uploaded', sent.length === 0, sent.join(' '))
}

/** Joint curves of the report and the zip of all files. */
export async function checkCurvesAndZip({ page, base, job }) {
  await page.goto(`${base}/#/jobs/${job.id}/report`)
  const section = page.locator('.joint-curves')
  await section.waitFor()
  const before = await section.locator('svg').first().innerHTML()
  await section.getByLabel('Joint').selectOption({ label: 'head' })
  check('another joint has other curves', (await section.locator('svg').first().innerHTML()) !== before)
  await page.goto(`${base}/#/jobs/${job.id}/files`)
  const [download] = await Promise.all([page.waitForEvent('download'), page.getByRole('link', { name: 'All files as one zip' }).click()])
  const name = download.suggestedFilename()
  check('all files are downloaded as one zip', name.endsWith('.zip') && (await download.failure()) === null, name)
}

/** A link to a moment and the editor for corrections on a phone. */
async function phoneCorrections(page, base, job) {
  await page.goto(`${base}/#/jobs/${job.id}/scene?frame=42&camera=cam01&person=0`)
  await page.locator('.camera-line strong', { hasText: 'cam01' }).waitFor()
  check('on a phone a link opens its frame', (await page.evaluate(() => window.wandless.frame())) === 42)
  await shot(page, 'phone-link')
  await checkAccess(page, 'link to a moment on a phone')
  const box = page.locator('.correction-box')
  await box.locator('summary', { hasText: 'Corrections' }).click()
  await box.getByRole('button', { name: /^Split at frame/ }).click()
  await box.scrollIntoViewIfNeeded()
  const [left, right] = await box.evaluate((element) => {
    const { left, right } = element.getBoundingClientRect()
    return [left, right]
  })
  check('on a phone corrections fit the screen', left >= 0 && right <= 390 && (await box.locator('.corrections li').count()) === 1, `${left} to ${right} px`)
  await shot(page, 'phone-corrections')
  await checkAccess(page, 'corrections on a phone')
}

/** On a phone the scene keeps half of the screen. */
export async function checkPhone({ browser, base, job }) {
  const page = await openPage(browser)
  await page.setViewportSize({ width: 390, height: 844 })
  await page.goto(`${base}/#/jobs/${job.id}`)
  await sceneReady(page)
  await drawn(page)
  const { height, overflow } = await page.evaluate(() => ({
    height: document.querySelector('.stage').getBoundingClientRect().height,
    overflow: document.documentElement.scrollWidth - innerWidth,
  }))
  check('on a phone the scene keeps half of the screen', height >= 0.5 * 844, `${height} px of 844`)
  check('on a phone nothing is wider than the screen', overflow <= 0, `${overflow} px`)
  await shot(page, 'phone')
  await checkAccess(page, 'scene on a phone')
  await phoneCorrections(page, base, job)
  for (const tab of ['report', 'files']) {
    await page.goto(`${base}/#/jobs/${job.id}/${tab}`)
    await page.locator(tab === 'report' ? '.chart' : '.files').first().waitFor()
    await shot(page, `phone-${tab}`)
    await checkAccess(page, `${tab} on a phone`)
  }
  await page.context().close()
}

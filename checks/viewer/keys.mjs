// A service with API keys: the key dialogue, and all functions with a key.

import { execFileSync } from 'node:child_process'
import { check, checkAccess, openPage, shot } from './browser.mjs'
import { sceneReady } from './scene.mjs'
import { PROGRAM, asDocument, startService } from './service.mjs'

export async function checkKeys(browser, folder, take) {
  const { base, stop } = await startService(folder)
  const made = execFileSync(PROGRAM, ['key', 'create', '--data', folder, '--name', 'check'], { encoding: 'utf8' })
  const key = /wl_\S+/.exec(made)[0]
  const page = await openPage(browser, { colorScheme: 'light' })
  await page.goto(base)
  await page.getByRole('textbox', { name: 'API key' }).fill('wl_wrong_key')
  await checkAccess(page, 'key dialogue')
  await page.getByRole('button', { name: 'Use this key' }).click()
  await page.getByText('does not accept this key').waitFor()
  check('a wrong key is reported', true)
  await shot(page, 'wrong-key')
  await checkAccess(page, 'wrong key')
  await page.getByRole('textbox', { name: 'API key' }).fill(key)
  await page.getByRole('button', { name: 'Use this key' }).click()
  await page.getByText('No jobs yet.').waitFor()
  check('the right key opens the page', true)

  const streams = []
  page.on('response', (answer) => answer.url().endsWith('/events') && streams.push(answer.status()))
  await page.locator('input[type=file]').first().setInputFiles({ name: 'take.json', mimeType: 'application/json', buffer: Buffer.from(asDocument(take)) })
  await page.getByText(/Expected solve time/).waitFor()
  check('with a key: upload and inspection', true)
  await page.getByRole('button', { name: 'Start', exact: true }).click()
  await page.locator('.job-page progress').waitFor()
  await sceneReady(page)
  check('with a key: events to the end', streams.length > 0 && streams.every((status) => status === 200), `answers ${streams.join(', ')}`)
  await page.getByRole('link', { name: 'Files' }).click()
  const [download] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'cameras.json' }).click()])
  check('with a key: download', (await download.failure()) === null)
  const rejected = await fetch(`${base}/v1/jobs`, { headers: { 'Sec-Fetch-Dest': 'empty' } })
  check('no password prompt of the browser for requests of scripts', rejected.status === 401 && /^Bearer/.test(rejected.headers.get('www-authenticate')))
  await page.context().close()
  stop()
}

// Starts Chromium, opens pages, takes screenshots and reports check results.

import axe from 'axe-core'
import { existsSync, mkdirSync } from 'node:fs'
import { dirname, join } from 'node:path'
import { fileURLToPath } from 'node:url'
import { chromium } from 'playwright-core'

const EXECUTABLE = process.env.CHROMIUM ?? '/usr/bin/chromium'
const FLAGS = [
  '--headless', '--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--enable-precise-memory-info',
  '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync',
]
const SHOTS = join(dirname(fileURLToPath(import.meta.url)), 'shots')

export const hasBrowser = () => existsSync(EXECUTABLE)

export function openBrowser() {
  mkdirSync(SHOTS, { recursive: true })
  return chromium.launch({ executablePath: EXECUTABLE, args: FLAGS })
}

/** Opens a page. Script errors and violations of the content security policy fail the check. */
export async function openPage(browser, { colorScheme = 'dark', isPolicyTried = false } = {}) {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, colorScheme, bypassCSP: false })
  const page = await context.newPage()
  page.on('pageerror', (error) => fail(`a script failed: ${error.message}`))
  page.on('console', (message) => !isPolicyTried && /Content Security Policy/.test(message.text()) && fail(message.text()))
  return page
}

/**
 * Opens the page of a job anew, by way of the list of jobs. Both addresses differ in their hash alone: the list must be drawn before
 * the second is set, otherwise a busy page sees the second twice and keeps what it shows.
 */
export async function openJobAnew(page, base, id) {
  await page.goto(`${base}/#/`)
  await page.locator('.home').waitFor()
  await page.goto(`${base}/#/jobs/${id}`)
}

export const shot = (page, name) => page.screenshot({ path: join(SHOTS, `${name}.png`) })

let failures = 0

export function check(what, isTrue, figure = '') {
  console.log(`${isTrue ? 'ok  ' : 'FAIL'} ${what}${figure === '' ? '' : `: ${figure}`}`)
  if (!isTrue) failures++
}

export const fail = (what) => check(what, false)
export const failed = () => failures > 0

/** Checks a page state with axe-core for serious and critical findings. It runs in an isolated world, so that the policy of the page stays unchanged. */
export async function checkAccess(page, state) {
  const session = await page.context().newCDPSession(page)
  const { frameTree } = await session.send('Page.getFrameTree')
  const world = await session.send('Page.createIsolatedWorld', { frameId: frameTree.frame.id, worldName: 'axe' })
  const contextId = world.executionContextId
  await session.send('Runtime.evaluate', { expression: axe.source, contextId })
  const expression = `axe.run({ resultTypes: ['violations'] }).then((found) => found.violations
    .filter(({ impact }) => impact === 'serious' || impact === 'critical')
    .map(({ id, nodes }) => id + ' ' + nodes.map((node) => node.target.join(' ')).join(', ')))`
  const { result } = await session.send('Runtime.evaluate', { expression, contextId, awaitPromise: true, returnByValue: true })
  await session.detach()
  check(`axe-core, ${state}`, result.value?.length === 0, (result.value ?? ['axe did not run']).join(' | ') || '0 findings')
}

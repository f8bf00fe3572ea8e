"""Solves several session folders at the same time: python3 several_takes.py SERVER FOLDER..."""

import asyncio
import sys

from wandless import AsyncClient, JobFailed


async def solve(client: AsyncClient, folder: str) -> str:
    session = await client.upload(folder)
    job = await client.submit(session["id"], labels={"folder": folder[-200:]})
    try:
        job = await client.wait(job["id"])
    except JobFailed as failed:
        return f"{folder}: {failed}"
    return f"{folder}: {(await client.result(job['id'])).verdict}"


async def main(server: str, folders: list[str]) -> None:
    async with AsyncClient(server) as client:
        for line in await asyncio.gather(*(solve(client, folder) for folder in folders)):
            print(line)


asyncio.run(main(sys.argv[1], sys.argv[2:]))

"""Proxies that break what they pass on: one for PostgreSQL, one for an S3 server."""

import http.client
import http.server
import random
import socket
import struct
import threading
import time

from cluster import free_port

#: Statements by which a transaction is known; the first match counts.
KINDS = [
    ("claim", b"WITH next AS MATERIALIZED"),
    ("accept", b"INSERT INTO jobs ("),
    ("cancel", b"CASE state WHEN 'queued' THEN 'canceled'"),
    ("finish", b"SET state = $1, boot = NULL"),
]


class PostgresProxy:
    """Passes on the messages of a PostgreSQL server. It can eat answers to COMMIT, stop inside a transaction, or cut all connections."""

    def __init__(self, port):
        self.upstream, self.port = port, free_port()
        self.eat, self.dice = 0.0, random.Random(1)
        self.eaten = {}
        self.is_cut = False
        self.pause_after, self.paused, self.resume = None, threading.Event(), threading.Event()
        self.connections, self.lock = set(), threading.Lock()
        self.listener = socket.create_server(("127.0.0.1", self.port), backlog=128)
        threading.Thread(target=self.accept, daemon=True).start()

    def url(self, database):
        return f"postgres://postgres@127.0.0.1:{self.port}/{database}"

    def cut(self):
        """Ends all connections, and refuses new ones."""
        self.is_cut = True
        with self.lock:
            ended = list(self.connections)
        for one in ended:
            close(one)

    def mend(self):
        self.is_cut = False

    def accept(self):
        while True:
            client, _ = self.listener.accept()
            if self.is_cut:
                close(client)
                continue
            try:
                server = socket.create_connection(("127.0.0.1", self.upstream))
            except OSError:
                close(client)
                continue
            with self.lock:
                self.connections |= {client, server}
            talk = Talk(self, client, server)
            for work in (talk.requests, talk.answers):
                threading.Thread(target=work, daemon=True).start()

    def forget(self, *ended):
        with self.lock:
            self.connections -= set(ended)
        for one in ended:
            close(one)


class Talk:
    """One connection of a client."""

    def __init__(self, proxy, client, server):
        self.proxy, self.client, self.server = proxy, client, server
        self.texts, self.kind, self.eats = {}, None, False

    def requests(self):
        try:
            while True:
                length = struct.unpack("!I", exactly(self.client, 4))[0]
                start = exactly(self.client, length - 4)
                if length == 8 and struct.unpack("!I", start)[0] == 80877103:
                    self.client.sendall(b"N")  # no TLS
                    continue
                self.server.sendall(struct.pack("!I", length) + start)
                break
            while True:
                head = exactly(self.client, 5)
                body = exactly(self.client, struct.unpack("!I", head[1:])[0] - 4)
                self.note(head[:1], body)
                self.server.sendall(head + body)
                if self.proxy.pause_after and self.kind == self.proxy.pause_after and head[:1] == b"S":
                    self.proxy.pause_after = None
                    self.proxy.paused.set()
                    self.proxy.resume.wait(60)
        except OSError:
            self.proxy.forget(self.client, self.server)

    def note(self, kind, body):
        """Follows what a transaction does, and decides whether its answer is eaten."""
        if kind == b"P":
            name, text = body.split(b"\0", 2)[:2]
            self.texts[name] = text
            self.see(text)
        elif kind == b"B":
            self.see(self.texts.get(body.split(b"\0", 2)[1], b""))
        elif kind == b"Q":
            self.see(body)
            if body.startswith(b"COMMIT"):
                self.decide()
        elif kind == b"S" and self.kind == "claim":
            self.decide()

    def see(self, text):
        self.kind = next((kind for kind, words in KINDS if words in text), self.kind)

    def decide(self):
        if self.kind and self.proxy.dice.random() < self.proxy.eat:
            self.proxy.eaten[self.kind] = self.proxy.eaten.get(self.kind, 0) + 1
            self.eats = True
        self.kind = None

    def answers(self):
        try:
            while True:
                head = exactly(self.server, 5)
                body = exactly(self.server, struct.unpack("!I", head[1:])[0] - 4)
                if self.eats:
                    if head[:1] == b"Z":  # the server is done: the client will never know
                        raise OSError
                    continue
                self.client.sendall(head + body)
        except OSError:
            self.proxy.forget(self.client, self.server)


def exactly(connection, n):
    data = b""
    while len(data) < n:
        part = connection.recv(n - len(data))
        if not part:
            raise OSError("the connection has ended")
        data += part
    return data


def close(connection):
    try:
        connection.shutdown(socket.SHUT_RDWR)
    except OSError:
        pass
    connection.close()


class StoreProxy:
    """Passes on the requests of an S3 server. Shares of them are answered 500 or 503, stall, are cut, or get other bytes."""

    def __init__(self, port):
        self.errors = self.stalls = self.cuts = self.wrong = 0.0
        self.stall_s, self.dice, self.is_cut = 10.0, random.Random(1), False
        self.counts = {"500/503": 0, "stalled": 0, "cut": 0, "wrong bytes": 0}
        proxy = self

        class Handler(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def pass_on(self):
                body = self.rfile.read(int(self.headers.get("content-length") or 0))
                if proxy.is_cut:
                    return self.drop()
                if proxy.happens(proxy.errors, "500/503"):
                    return self.reply(proxy.dice.choice([500, 503]), [], b"<Error><Code>SlowDown</Code></Error>")
                if proxy.happens(proxy.stalls, "stalled"):
                    time.sleep(proxy.stall_s)
                upstream = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
                headers = {name: value for name, value in self.headers.items() if name.lower() != "connection"}
                if self.command == "PUT" and proxy.happens(proxy.cuts, "cut"):
                    return self.cut(upstream, headers, body)
                upstream.request(self.command, self.path, body=body or None, headers=headers)
                answer = upstream.getresponse()
                data = answer.read()
                if self.command == "GET" and answer.status == 200 and data and proxy.happens(proxy.wrong, "wrong bytes"):
                    at = proxy.dice.randrange(len(data))
                    data = data[:at] + bytes([data[at] ^ 1]) + data[at + 1:]
                self.reply(answer.status, answer.getheaders(), data)
                upstream.close()

            do_GET = do_PUT = do_POST = do_DELETE = do_HEAD = pass_on

            def cut(self, upstream, headers, body):
                """Sends a sixteenth of the body, or two, or fifteen."""
                upstream.putrequest(self.command, self.path, skip_host=True, skip_accept_encoding=True)
                for name, value in headers.items():
                    upstream.putheader(name, value)
                upstream.endheaders()
                upstream.send(body[:len(body) * proxy.dice.randrange(16) // 16])
                upstream.close()
                self.drop()

            def drop(self):
                self.close_connection = True
                close(self.connection)

            def reply(self, status, headers, data):
                self.send_response_only(status)
                length = None
                for name, value in headers:
                    if name.lower() == "content-length":
                        length = value
                    elif name.lower() not in ("transfer-encoding", "connection"):
                        self.send_header(name, value)
                self.send_header("Content-Length", length if self.command == "HEAD" and length else str(len(data)))
                self.end_headers()
                if self.command != "HEAD":
                    self.wfile.write(data)

            def log_message(self, *_):
                pass

            def handle(self):
                try:
                    super().handle()
                except OSError:
                    pass  # the client has left

        class Server(http.server.ThreadingHTTPServer):
            request_queue_size = 128
            daemon_threads = True

            def handle_error(self, *_):
                pass  # a cut connection

        self.server = Server(("127.0.0.1", 0), Handler)
        self.port = self.server.server_port
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def happens(self, share, name):
        if self.dice.random() >= share:
            return False
        self.counts[name] += 1
        return True

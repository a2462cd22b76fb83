"""Chromium without a window, driven over its debugging pipe (`--remote-debugging-pipe`)."""

import asyncio
import base64
import itertools
import json
import os
import shutil
import signal

CHROMIUM = shutil.which("chromium")
TIME_LIMIT_S = 120.0
OPTIONS = ("--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage")
"""Options of the command line; the third one draws WebGL without a graphics card."""


class Tab:
    """A page in a browser.

    Parameters
    ----------
    pipe
        Connection to the browser.
    session
        Session of the page.
    """

    def __init__(self, pipe, session):
        self._pipe, self._session = pipe, session
        self._load_event = asyncio.Event()
        pipe.tabs[session] = self

    async def prepare(self):
        """Enable the browser's events about the page."""
        for domain in ("Page", "Log", "Network", "Runtime"):
            await self.call(f"{domain}.enable")
        return self

    async def call(self, method, **params):
        """Call a method of the protocol, and return its result."""
        return await self._pipe.call(method, self._session, params)

    async def open(self, url):
        """Open an address, and wait until the page is loaded."""
        self._load_event.clear()
        await self.call("Page.navigate", url=url)
        await self._wait_until_loaded()

    async def press(self, selector):
        """Press a button that leads to another page."""
        self._load_event.clear()
        await self.evaluate(f"document.querySelector({selector!r}).click()")
        await self._wait_until_loaded()

    async def evaluate(self, expression):
        """Return the value of an expression on the page."""
        return (await self.call("Runtime.evaluate", expression=expression))["result"].get("value")

    async def wait_for(self, expression):
        """Wait until an expression on the page is true, polled by the page ten times a second."""
        polling_script = f"""new Promise(done => {{
            const check = () => {{ if ({expression}) done(true); else setTimeout(check, 100) }}
            check()
        }})"""
        async with asyncio.timeout(TIME_LIMIT_S):
            while not await self._await_promise(polling_script):
                await asyncio.sleep(0)  # another page was loaded

    async def _await_promise(self, expression):
        """Return the value of a promise on the page, or None if another page is loaded first."""
        try:
            answer = await self.call("Runtime.evaluate", expression=expression, awaitPromise=True)
        except AssertionError:
            return None
        return answer["result"].get("value")

    async def choose_file(self, selector, path):
        """Choose a file in a form."""
        page = (await self.call("DOM.getDocument"))["root"]["nodeId"]
        node = (await self.call("DOM.querySelector", nodeId=page, selector=selector))["nodeId"]
        await self.call("DOM.setFileInputFiles", files=[str(path)], nodeId=node)

    async def drop_file(self, selector, path):
        """Drag a file onto an element, and drop it."""
        area = f"document.querySelector({selector!r}).getBoundingClientRect()"
        left, top, width, height = [
            await self.evaluate(f"{area}.{side}") for side in ("left", "top", "width", "height")
        ]
        data = {"items": [], "files": [str(path)], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            position = {"x": left + width / 2, "y": top + height / 2}
            await self.call("Input.dispatchDragEvent", type=kind, data=data, **position)

    async def click(self, x, y):
        """Click a point of the window."""
        for kind in ("mousePressed", "mouseReleased"):
            await self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    async def cut_network(self, is_cut=True):
        """Cut the page off from the network, or connect it again."""
        no_limits = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
        await self.call("Network.emulateNetworkConditions", offline=is_cut, **no_limits)

    async def read_text(self):
        """Return the text of the page."""
        return await self.evaluate("document.body.innerText")

    async def take_picture(self, path):
        """Save a screenshot of the page."""
        path.write_bytes(base64.b64decode((await self.call("Page.captureScreenshot"))["data"]))

    async def _wait_until_loaded(self):
        async with asyncio.timeout(TIME_LIMIT_S):
            await self._load_event.wait()

    def on_event(self, method, params):
        """Process an event of the page."""
        if method == "Page.loadEventFired":
            self._load_event.set()


class Pipe:
    """The debugging pipe of a browser, which assigns answers to calls and events to tabs."""

    def __init__(self, out):
        self._out = out
        self._numbers = itertools.count(1)
        self._answers = {}
        self.tabs, self.messages = {}, []

    async def call(self, method, session, params):
        """Call a method of a session, or of the browser if the session is None, and return its result."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": params}
        if session:
            message["sessionId"] = session
        self._answers[number] = asyncio.get_running_loop().create_future()
        self._out.write(json.dumps(message).encode() + b"\0")
        async with asyncio.timeout(TIME_LIMIT_S):
            answer = await self._answers[number]
        del self._answers[number]
        assert "error" not in answer, (method, answer)
        return answer["result"]

    async def open_session(self):
        """Open a tab, and return its session."""
        target = await self.call("Target.createTarget", None, {"url": "about:blank", "newWindow": True})
        attach = {"targetId": target["targetId"], "flatten": True}
        attachment = await self.call("Target.attachToTarget", None, attach)
        return attachment["sessionId"]

    async def read_messages(self, reader):
        """Pass answers to the calls that wait for them, and events to their tabs."""
        while True:
            message = json.loads((await reader.readuntil(b"\0"))[:-1])
            if message.get("id") in self._answers:
                self._answers[message["id"]].set_result(message)
            elif message.get("method") == "Log.entryAdded":
                self.messages.append(message["params"]["entry"]["text"])
            elif message.get("sessionId") in self.tabs:
                self.tabs[message["sessionId"]].on_event(message["method"], message["params"])


class Chromium(Tab):
    """Browser with its own profile, and its first tab. `async with` starts and ends it.

    Parameters
    ----------
    profile
        Folder for the profile.
    hosts
        Rules that resolve host names, such as `MAP farm.lab 127.0.0.1`.
    """

    def __init__(self, profile, hosts):
        self._command = [str(CHROMIUM), "--headless=new", "--no-first-run", *OPTIONS]
        self._command += ["--remote-debugging-pipe", f"--user-data-dir={profile}"]
        self._command += [f"--host-resolver-rules={hosts}", "--window-size=1000,700"]

    @property
    def messages(self):
        """Lines that the browser logged, such as violations of a page's policy."""
        return self._pipe.messages

    async def open_tab(self):
        """Open another, empty tab."""
        return await Tab(self._pipe, await self._pipe.open_session()).prepare()

    def suspend(self, is_suspended=True):
        """Stop all processes of the browser, as a computer does when it goes to sleep, or continue them."""
        os.killpg(self._process.pid, signal.SIGSTOP if is_suspended else signal.SIGCONT)

    async def __aenter__(self):
        to_browser, own_write = os.pipe()
        own_read, from_browser = os.pipe()

        def place_pipes_at_3_and_4():
            read, write = os.dup(to_browser), os.dup(from_browser)
            for number, end in ((3, read), (4, write)):
                os.dup2(end, number)
                os.set_inheritable(number, True)  # dup2 does nothing if both are the same

        self._process = await asyncio.create_subprocess_exec(
            *self._command,
            preexec_fn=place_pipes_at_3_and_4,
            close_fds=False,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._out = os.fdopen(own_write, "wb", buffering=0)
        self._in = os.fdopen(own_read, "rb", buffering=0)
        reader = asyncio.StreamReader(limit=2**26)
        self._transport, _ = await asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader), self._in
        )
        pipe = Pipe(self._out)
        self._read_task = asyncio.create_task(pipe.read_messages(reader))
        super().__init__(pipe, await pipe.open_session())
        return await self.prepare()

    async def __aexit__(self, *_):
        self._read_task.cancel()
        self._out.close()  # the browser ends when its pipe is closed
        self._transport.close()
        try:
            async with asyncio.timeout(TIME_LIMIT_S):
                await self._process.wait()
        except TimeoutError:
            os.killpg(self._process.pid, signal.SIGKILL)
            await self._process.wait()

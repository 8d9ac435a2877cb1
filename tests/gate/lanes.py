"""Lanes: parts side by side, builds beside them, then the parts that want the machine for themselves.

There is a lane for each processor, and most parts play several tests at a time, since tests mostly wait.
Builds run one after another with a lower priority, in what tests leave free.

Invariant: nothing begins while a test is played again, nothing runs beside a part that is alone, and of two
parts that keep a processor busy one runs at a time.
"""

import threading


class Lanes:
    """Runs parts and tells `ended(part, ran)` of each, from one thread at a time."""

    def __init__(self, count, play, ended, began=lambda part: None):
        self.count = count
        self.play = (
            play  # (part, quiet) -> what it came to; `quiet` is a context in which nothing else begins
        )
        self.ended = ended
        self.began = began
        self.state = threading.Condition()
        self.waiting = []
        self.alone = []
        self.building = True
        self.heavy = False
        self.holding = 0
        self.over = False

    def run(self, builds):
        """Builds one after another, and runs to its end whatever each made. A build is (name, function that
        answers parts, or `None`).
        """
        workers = [
            threading.Thread(target=self._work, name=f"lane-{n}", daemon=True) for n in range(self.count)
        ]
        for worker in workers:
            worker.start()
        for _, build in builds:
            if self.over:
                break
            parts = build() or []
            with self.state:
                self.waiting += [part for part in parts if not part.alone and not self.over]
                self.alone += [part for part in parts if part.alone]
                self.state.notify_all()
        with self.state:
            self.building = False
            self.state.notify_all()
        for worker in workers:
            worker.join()
        for part in self.alone:
            if not self.over:
                self._play(part)

    def stop(self):
        """Nothing begins any more."""
        with self.state:
            self.over = True
            self.waiting.clear()
            self.state.notify_all()

    def _work(self):
        while True:
            with self.state:
                self.state.wait_for(lambda: self.over or self._next() or self._nothing_comes())
                part = self._next()
                if self.over or not part:
                    return
                self.waiting.remove(part)
                self.heavy = self.heavy or part.heavy
            self._play(part)
            if part.heavy:
                with self.state:
                    self.heavy = False
                    self.state.notify_all()

    def _next(self):
        """The first part that may begin now."""
        if self.holding:
            return None
        return next((part for part in self.waiting if not (part.heavy and self.heavy)), None)

    def _nothing_comes(self):
        return not self.waiting and not self.building

    def _play(self, part):
        self.began(part)
        ran = self.play(part, Quiet(self))
        with self.state:
            # Processes that were ended by whoever stopped the run say nothing of their tests.
            if not self.over:
                self.ended(part, ran)
            self.state.notify_all()


class Quiet:
    """While it is entered, no lane begins another part."""

    def __init__(self, lanes):
        self.lanes = lanes

    def __enter__(self):
        with self.lanes.state:
            self.lanes.holding += 1

    def __exit__(self, *_):
        with self.lanes.state:
            self.lanes.holding -= 1
            self.lanes.state.notify_all()

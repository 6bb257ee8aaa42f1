"""A module whose import waits for a lock that is never released."""

import threading

LOCK = threading.Lock()
LOCK.acquire()
LOCK.acquire()

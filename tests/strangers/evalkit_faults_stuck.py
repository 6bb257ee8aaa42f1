"""A module whose import waits for a lock that nobody gives back."""

import threading

LOCK = threading.Lock()
LOCK.acquire()
LOCK.acquire()

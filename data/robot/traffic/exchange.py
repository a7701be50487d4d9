"""Records of a line to packets and faults: the same code while they come in and when they are read again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

from data.robot.packets import ANSWER_TIMEOUT
from data.robot.traffic.motion import Packet
from data.robot.traffic.recording import GONE, RECEIVED, SENT, Record
from data.robot.traffic.stream import GARBAGE, SHIFTED, SHORT, Framed, Stream, Unframed

LOST, LATE, DEVICE_GONE = "lost", "late", "device gone"
FAULTS = (LOST, LATE, SHORT, SHIFTED, GARBAGE, DEVICE_GONE)
"""lost: nothing came after a command. late: an answer after its time; it is used, unless a newer one came with it.
short, shifted, garbage: see `data.robot.traffic.stream.Unframed`. device gone: the line broke off."""


class Exchange:
    """Commands and answers of a link, record by record.

    The time of a packet is that of the bytes that ended it; of several that came at once only the newest is used, so
    times increase.
    """

    def __init__(self, *, framed: bool) -> None:
        """Before the first record."""
        self._stream: Stream = Framed() if framed else Unframed()
        self._counted: Counter[str] = Counter()
        self._asked: float | None = None  # when the command was sent that has no answer yet
        self._silent = True  # since then
        self._unanswered = 0  # commands that were given up as lost, in a row

    @property
    def faults(self) -> dict[str, int]:
        """How often each of `FAULTS` was met so far."""
        both = self._counted + self._stream.faults
        return {name: both[name] for name in FAULTS}

    def consume(self, record: Record) -> list[Packet]:
        """The packets that can be used now, oldest first, times increasing."""
        if record.kind == SENT:
            if self._asked is not None and self._silent:
                self._counted[LOST] += 1
                self._unanswered += 1
            self._asked, self._silent = record.t, True
        elif record.kind == GONE:
            self._counted[DEVICE_GONE] += 1
            self._asked, self._unanswered = None, 0
        elif record.kind == RECEIVED:
            self._silent = False
            return self._received(record)
        return []

    def _received(self, record: Record) -> list[Packet]:
        packets = self._stream.feed(record.t, record.data)
        used: list[Packet] = []
        for packet in packets:
            if used and used[-1].t == packet.t:
                self._late()
                packet = replace(packet, joined=packet.joined and used.pop().joined)
            used.append(packet)
        if used:
            if self._asked is None or record.t - self._asked > ANSWER_TIMEOUT:
                self._late()
            self._asked, self._unanswered = None, 0
        return used

    def _late(self) -> None:
        """An answer that was taken for lost, if one was, is late."""
        self._counted[LATE] += 1
        if self._unanswered:
            self._unanswered -= 1
            self._counted[LOST] -= 1


def decoded(records: Iterable[Record], *, framed: bool) -> tuple[list[Packet], dict[str, int]]:
    """All packets of records, and how often each of `FAULTS` was met; as the link had them when they came."""
    exchange = Exchange(framed=framed)
    packets = [packet for record in records for packet in exchange.consume(record)]
    return packets, exchange.faults

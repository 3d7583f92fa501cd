"""One topic of a file being written."""

from __future__ import annotations

from dataclasses import dataclass, field

from hd_control.record.accounting import TopicAccount
from hd_control.record.metadata_yaml import TopicEntry


@dataclass
class Channel:
    """One topic of the file, with what is not written yet when chunks are used."""

    topic: str
    type_name: str
    type_hash: str
    number: int
    latched: bool
    account: TopicAccount
    records: bytearray = field(default_factory=bytearray)
    times: list[int] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)

    def entry(self) -> TopicEntry:
        """The topic as metadata.yaml lists it."""
        return TopicEntry(self.topic, self.type_name, self.type_hash, self.account.written, self.latched)

"""Writes bags: a rosbag2 directory (metadata.yaml version 9) with one MCAP file.

    with BagWriter(path, metadata={"seed": "7"}) as bag:
        bag.attach("robot.urdf", urdf)
        bag.write("/encoder", stamp_ns, log_time_ns, payload)

`live=True` appends message after message, so a killed process loses only what was not flushed; `close` then rewrites
the file to its compact form (chunks, zstd, CRC), compares it and renames. `live=False` writes compact chunks at once:
for simulation and import, also whole columns at a time.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from hd_control._pump import RecordFile
from hd_control.core.errors import BagError
from hd_control.core.topics import topic_info
from hd_control.record import bag_folder
from hd_control.record.accounting import TopicAccount, header_of
from hd_control.record.bag_folder import attachment_bytes, make_folder, provenance, write_error
from hd_control.record.cdr import Buffer, FixedCodec
from hd_control.record.mcap_write import LONGEST_RECORD, MESSAGE, Channel, McapFile, message_record, message_records
from hd_control.record.schema import message_definition, type_hash

FLUSH_NS = 20_000_000
FLUSH_BYTES = 65_536
CHUNK_BYTES = 1 << 20
SESSION, ACCOUNTING, RECOVERY = "hd_session", "hd_accounting", "hd_recovery"


class BagWriter:
    """A recording being written. Not thread-safe; reads no clock but once for the start time, if none is given."""

    def __init__(
        self,
        path: str | Path,
        *,
        live: bool = True,
        compact: bool = True,
        force: bool = False,
        metadata: Mapping[str, str] | None = None,
        start_time_utc: str | None = None,
    ) -> None:
        """Creates the directory `path`; its parent must exist. Raises BagError if it cannot, or if `path` exists.

        `force` replaces an existing bag, never anything else. `metadata` are texts for the session record: seed, run
        ids, configuration. With `start_time_utc` given, equal runs make equal files.
        """
        self.path = Path(path)
        self.live, self.compact, self.failed, self.closed = live, compact, "", False
        make_folder(self.path, force)
        self.file_path = self.path / f"{self.path.name}_0.mcap"
        self._channels: dict[str, Channel] = {}
        self._by_any_name: dict[str, Channel] = {}
        self._schemas: dict[str, int] = {}
        self._first_pending_ns, self._has_pending = 0, False
        self._unflushed: list[tuple[TopicAccount, int]] = []
        try:
            self._raw = self.file_path.open("xb", buffering=0)
        except OSError as error:
            raise write_error(self.file_path, error) from None
        self._file = McapFile(self._raw)
        self.set_metadata(SESSION, {**provenance(start_time_utc), **(metadata or {})})
        self.flush()

    @property
    def accounts(self) -> dict[str, TopicAccount]:
        """The counts of each topic; a recorder adds its drops here."""
        return {topic: channel.account for topic, channel in self._channels.items()}

    @property
    def growing(self) -> RecordFile:
        """The end of the file, for a thread that appends beside this one; it never waits for the interpreter."""
        return self._file.growing

    def add_topic(self, topic: str, type_name: str = "", definition: str = "", period_ns: int | None = None) -> Channel:
        """Announces a topic. Type, definition and period come from the schema if not given.

        Raises BagError for a topic that is not in the schema and comes without a type.
        """
        name = "/" + topic.strip("/")
        if name in self._channels:
            return self._channels[name]
        known = topic_info(name)
        type_name = type_name or (known.type_name if known else "")
        if not type_name:
            raise BagError(f"{name}: not a topic of this package; call add_topic with its type first")
        definition = definition or message_definition(type_name)
        latched = bool(known and known.latched)
        if type_name not in self._schemas:
            self._schemas[type_name] = self._file.add_schema(type_name, definition)
        metadata = {
            "offered_qos_profiles": bag_folder.dump([bag_folder.qos_profile(latched)]),
            "topic_type_hash": type_hash(type_name),
        }
        number = self._file.add_channel(name, self._schemas[type_name], metadata)
        period = (known.period_ns if known else 0) if period_ns is None else period_ns
        channel = Channel(name, type_name, type_hash(type_name), number, latched, TopicAccount(period))
        self._channels[name] = channel
        return channel

    def write(self, topic: str, stamp_ns: int | None, log_time_ns: int, payload: Buffer) -> None:
        """One message. `stamp_ns` None: taken from its header, else the log time. Raises BagError if it cannot."""
        channel = self._channel(topic)
        if not 0 <= log_time_ns < 1 << 63:
            raise BagError(f"{topic}: log time {log_time_ns} ns is outside [0, 2^63)")
        if len(payload) + MESSAGE.size > LONGEST_RECORD:
            raise BagError(f"{topic}: a message of {len(payload)} bytes is longer than any reader takes; split it")
        stamp, frame_id = header_of(channel.type_name, payload)
        channel.account.see(stamp, frame_id)
        stamp = stamp if stamp_ns is None else stamp_ns
        sequence = channel.account.written & 0xFFFFFFFF
        publish_ns = log_time_ns if stamp is None else max(stamp, 0)
        channel.account.wrote(1)
        if self.live:
            self._file.add_message(channel.number, sequence, log_time_ns, publish_ns, payload)
            self._unflushed.append((channel.account, self._file.end))
            self._flush_if_due(log_time_ns)
            return
        channel.offsets.append(len(channel.records))
        channel.times.append(log_time_ns)
        channel.records += message_record(channel.number, sequence, log_time_ns, publish_ns, payload)
        if len(channel.records) >= CHUNK_BYTES:
            self._write_chunk(channel)

    def write_columns(
        self,
        topic: str,
        codec: FixedCodec,
        stamps_ns: ArrayLike,
        log_times_ns: ArrayLike | None = None,
        frame_id: str = "",
        **values: ArrayLike,
    ) -> None:
        """Many messages of a fixed layout; arrays are (n, numbers). Log times default to the stamps."""
        channel = self._channel(topic)
        if codec.type_name != channel.type_name:
            raise BagError(f"{topic}: is {channel.type_name}, the codec makes {codec.type_name}")
        stamps = np.asarray(stamps_ns, np.int64).reshape(-1)
        logs = stamps if log_times_ns is None else np.asarray(log_times_ns, np.int64).reshape(-1)
        if len(logs) != len(stamps) or (len(logs) and int(logs.min()) < 0):
            raise BagError(f"{topic}: {len(logs)} log times for {len(stamps)} stamps, or a negative one")
        arrays = {name: np.asarray(value, np.float64) for name, value in values.items()}
        step = max(1, CHUNK_BYTES // (MESSAGE.size + codec.size))
        self._write_chunk(channel)
        for begin in range(0, len(stamps), step):
            part = slice(begin, begin + step)
            rows = codec.encode_columns(stamps[part], frame_id, **{name: array[part] for name, array in arrays.items()})
            numbers = channel.account.written + np.arange(len(rows))
            records, places = message_records(channel.number, numbers, logs[part], stamps[part], rows)
            channel.account.see_many(stamps[part], frame_id.encode("utf-8"))
            try:
                self._guard(partial(self._file.add_chunk, channel.number, records, logs[part], places))
            except BagError:
                channel.account.lost_on_disk(len(rows))
                raise
            channel.account.wrote(len(rows))

    def attach(self, name: str, data: str | bytes, media_type: str = "text/plain") -> None:
        """Carries a file inside the recording: parameters, URDF, model."""
        payload = data.encode("utf-8") if isinstance(data, str) else data
        self._check_open()
        if len(payload) > LONGEST_RECORD:
            raise BagError(f"{name}: {len(payload)} bytes are more than any reader takes; attach a smaller file")
        self._file.add_attachment(name, media_type, payload, 0)
        self.flush()

    def attach_file(self, path: str | Path) -> None:
        """Attaches a file from disk. Raises BagError if it cannot be read."""
        self.attach(Path(path).name, attachment_bytes(Path(path)))

    def set_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Writes a metadata record now; a later one of the same name replaces it for the reader."""
        self._check_open()
        self._file.add_metadata(name, {str(key): str(value) for key, value in values.items()})

    def store_accounts(self) -> dict[str, str]:
        """Writes the counts of each topic as they are now and returns them as JSON texts; the last ones count."""
        accounts = {name: json.dumps(account.as_dict()) for name, account in self.accounts.items()}
        self.set_metadata(ACCOUNTING, accounts)
        return accounts

    def flush(self) -> None:
        """Hands everything to the operating system: a kill then loses nothing. Call at least every 20 ms while live."""
        if self._file.pending_bytes == 0:
            return
        try:
            self._guard(self._file.flush)
        except BagError:
            for account, end in self._unflushed:
                if end > self._file.position:
                    account.wrote(-1)
                    account.lost_on_disk(1)
            raise
        finally:
            self._unflushed.clear()
        self._has_pending = False

    @property
    def fileno(self) -> int:
        """The open file, for fsync from another thread."""
        return self._raw.fileno()

    def close(self, reason: str = "", compact: bool | None = None, give_up: Callable[[], bool] | None = None) -> Path:
        """Writes accounts, index and metadata.yaml, then the compact form if wanted. Returns the bag's path.

        `give_up` is asked during the rewrite; true leaves the plain file. Raises BagError if the disk refuses.
        """
        if self.closed:
            return self.path
        self._check_open()
        for channel in self._channels.values():
            self._write_chunk(channel)
        accounts = self.store_accounts()
        self.set_metadata("hd_close", {"reason": reason or "closed"})
        self._guard(self._file.finish)
        self._guard(lambda: os.fsync(self._raw.fileno()))
        self._raw.close()
        self.closed = True
        self._write_yaml(accounts, reason)
        if self.live and (self.compact if compact is None else compact):
            from hd_control.record.compact import compact_file

            compact_file(self.file_path, give_up)
        return self.path

    def abandon(self) -> None:
        """Closes the file without index: what was written stays readable."""
        self.closed = True
        self._raw.close()

    def _write_yaml(self, accounts: Mapping[str, str], reason: str) -> None:
        topics = [channel.entry() for channel in self._channels.values()]
        custom = {
            ACCOUNTING: json.dumps({name: json.loads(text) for name, text in accounts.items()}),
            "close_reason": reason or "closed",
        }
        info = bag_folder.document(self.file_path.name, topics, self._file.first_ns, self._file.last_ns, custom)
        try:
            bag_folder.save(self.path, info)
        except OSError as error:
            raise write_error(self.path / bag_folder.FILE_NAME, error) from None

    def _channel(self, topic: str) -> Channel:
        self._check_open()
        channel = self._by_any_name.get(topic)
        if channel is None:
            self.add_topic(topic)
            channel = self._by_any_name[topic] = self._channels["/" + topic.strip("/")]
        return channel

    def _write_chunk(self, channel: Channel) -> None:
        if not channel.times:
            return
        data, times, offsets = bytes(channel.records), np.array(channel.times), np.array(channel.offsets)
        channel.records, channel.times, channel.offsets = bytearray(), [], []
        try:
            self._guard(partial(self._file.add_chunk, channel.number, data, times, offsets))
        except BagError:
            channel.account.wrote(-len(times))
            channel.account.lost_on_disk(len(times))
            raise

    def _flush_if_due(self, log_time_ns: int) -> None:
        if not self._has_pending:
            self._first_pending_ns, self._has_pending = log_time_ns, True
        waited = log_time_ns - self._first_pending_ns
        if not 0 <= waited < FLUSH_NS or self._file.pending_bytes >= FLUSH_BYTES:
            self.flush()

    def refused(self, error: OSError) -> BagError:
        """Notes that the disk refused: nothing more is written. Returns what to report."""
        self.failed = str(error.strerror or error)
        return write_error(self.file_path, error)

    def _guard(self, action: Callable[[], object]) -> None:
        try:
            action()
        except OSError as error:
            raise self.refused(error) from None

    def _check_open(self) -> None:
        if self.failed:
            why = f"recording stopped ({self.failed}); what was written stays"
            raise BagError(f"{self.file_path}: {why}, start a new bag")
        if self.closed:
            raise BagError(f"{self.file_path}: the bag is closed; start a new one")

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self.failed:
            self.abandon()
        else:
            self.close("error" if kind else "")

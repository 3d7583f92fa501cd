"""Rewrites a closed plain file into chunks, zstd and CRC: a new file, compared with the old one, then renamed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hd_control.core.errors import BagError
from hd_control.core.files import replaced
from hd_control.record.mcap_read import McapSource
from hd_control.record.mcap_write import LONGEST_RECORD, McapFile, block_records, parts

Digests = dict[int, Any]


class _GivenUp(Exception):
    """The caller wants the plain file to stay."""


def compact_file(path: Path, give_up: Callable[[], bool] | None = None) -> bool:
    """Replaces the MCAP file by its compact form; True if done.

    The plain file stays if anything is not equal, if there is no space, or if `give_up()` becomes true. Raises BagError
    only if the compared files differ, which is a defect.
    """
    try:
        with replaced(path, durable=True) as target:
            source = McapSource(path)
            written = _write(source, target, give_up)
            if _digests(McapSource(target)) != written:
                raise BagError(f"{path}: the compact copy differs from the recording; the recording stays as it is")
        return True
    except (OSError, _GivenUp):
        return False


def _write(source: McapSource, target: Path, give_up: Callable[[], bool] | None) -> dict[int, str]:
    digests: Digests = {}
    with target.open("xb", buffering=0) as raw:
        file = McapFile(raw)
        numbers = _copy_descriptions(source, file)
        for name, metadata in source.metadata.items():
            file.add_metadata(name, metadata)
        for name, attachment in source.attachment_records().items():
            file.add_attachment(name, attachment.media_type, attachment.data, attachment.log_time)
        for block in source.blocks(list(source.topics)):
            if give_up is not None and give_up():
                raise _GivenUp
            for channel in np.unique(block.channel).tolist():
                for part in parts(block.select(block.channel == channel), LONGEST_RECORD):
                    data, places = block_records(part, numbers[channel])
                    digests.setdefault(channel, hashlib.sha256()).update(data)
                    file.add_chunk(numbers[channel], data, part.log_time_ns, places)
        file.finish()
    return {channel: digest.hexdigest() for channel, digest in digests.items()}


def _copy_descriptions(source: McapSource, file: McapFile) -> dict[int, int]:
    """Schemas and channels in the order of their numbers, so that message records can be copied as they are."""
    schemas = {s.id: file.add_schema(s.name, s.data.decode("utf-8")) for s in source.schema_records()}
    numbers = {}
    for channel in source.channel_records():
        numbers[channel.id] = file.add_channel(channel.topic, schemas[channel.schema_id], dict(channel.metadata))
        if numbers[channel.id] != channel.id:
            raise OSError("channel numbers with holes cannot be copied")
    return numbers


def _digests(source: McapSource) -> dict[int, str]:
    digests: Digests = {}
    for block in source.blocks(list(source.topics)):
        for channel in np.unique(block.channel).tolist():
            data, _ = block_records(block.select(block.channel == channel), channel)
            digests.setdefault(channel, hashlib.sha256()).update(data)
    return {channel: digest.hexdigest() for channel, digest in digests.items()} if not source.problems else {}

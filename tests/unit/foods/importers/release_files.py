"""Releases as a mapping of file name to text, written as a folder or as a zip."""

import zipfile


def write_folder(path, files, encoding="utf-8"):
    path.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (path / name).write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
    return path


def write_zip(path, files, encoding="utf-8", inside=""):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(inside + name, content if isinstance(content, bytes) else content.encode(encoding))
    return path


def damage_member(path, name):
    """Flips a byte in the middle of a file's packed bytes: its checksum no longer fits."""
    with zipfile.ZipFile(path) as archive:
        entry = next(entry for entry in archive.infolist() if entry.filename.endswith(name))
    raw = bytearray(path.read_bytes())
    start = entry.header_offset + 30 + len(entry.filename) + entry.compress_size // 2
    raw[start] ^= 0xFF
    path.write_bytes(raw)


def replaced(old, new):
    """A change of a text: this part of it, once."""

    def change(text):
        assert old in text
        return text.replace(old, new, 1)

    return change

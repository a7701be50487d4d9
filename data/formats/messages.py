"""Messages of ROS printed as YAML (`rostopic echo`, `ros2 topic echo`) as rows of a table."""

import re


def numbered_rows(text: str) -> list[tuple[int, str]]:
    """Lines of a text with numbers from 1; of messages a header and a row each, at its first line.

    A field is named by its path, as `pose.pose.position.x`; elements of lists have numbers from 0 behind it. Seconds
    and nanoseconds of a stamp are one field. Messages whose fields are not those of the first are left out.
    """
    lines = list(enumerate(text.splitlines(), 1))
    first = next((line for _, line in lines if line.strip() not in ("", "---")), "")
    if not re.fullmatch(r"[A-Za-z_]\w*:\s*", first) or not any(line.rstrip() == "---" for _, line in lines):
        return lines
    messages: list[tuple[int, dict[str, str]]] = [(0, {})]
    path: list[tuple[int, str]] = []
    for number, line in lines:
        body, indent = line.strip(), len(line) - len(line.lstrip())
        if body == "---":
            messages.append((number + 1, {}))
            continue
        item, key = body.startswith("- "), re.match(r"(\w+):\s*(.*)", body)
        while path and (path[-1][0] > indent or (path[-1][0] == indent and not item)):
            path.pop()
        name, found = ".".join(part for _, part in path), messages[-1][1]
        if item:
            found[f"{name}{sum(k.startswith(name) for k in found)}"] = body[2:].strip()
        elif key is not None and key[2].startswith("["):
            listed = key[2].strip("[]").split(",")
            found |= {f"{name}.{key[1]}{k}".lstrip("."): value.strip() for k, value in enumerate(listed)}
        elif key is not None and key[2]:
            found[f"{name}.{key[1]}".lstrip(".")] = key[2].strip("'\"").replace(",", " ")
        elif key is not None:
            path.append((indent, key[1]))
    rows = [(number or 1, _stamped(fields)) for number, fields in messages if fields]
    names = tuple(rows[0][1])
    whole = [(number, ",".join(fields.values())) for number, fields in rows if tuple(fields) == names]
    return [(1, ",".join(names)), *whole]


def _stamped(fields: dict[str, str]) -> dict[str, str]:
    """With one field for the seconds and nanoseconds of a stamp."""
    out: dict[str, str] = {}
    for name, value in fields.items():
        stamp, _, part = name.rpartition(".")
        if part in ("nsecs", "nanosec") and stamp in out:
            out[stamp] += f".{int(value):09d}"
        else:
            out[stamp if part in ("secs", "sec") else name] = value
    return out

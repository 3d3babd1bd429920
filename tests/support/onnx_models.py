"""Tiny ONNX networks, written as protobuf bytes: what they answer can be computed by hand.

Only the messages and fields that these need (onnx.proto: ModelProto, GraphProto, NodeProto, TensorProto).
"""

import struct

import numpy as np

FLOAT, INT64 = 1, 7  # TensorProto.DataType
OPSET, IR = 13, 8


def colour_classifier(weights: np.ndarray, side: int = 8) -> bytes:
    """Scores (1, labels): the mean of each channel over the picture, (1, 3, side, side), by weights (3, labels)."""
    nodes = [
        node("GlobalAveragePool", ["x"], ["means"]),
        node("Flatten", ["means"], ["flat"], axis=1),
        node("Gemm", ["flat", "w"], ["y"]),
    ]
    return model(nodes, {"w": weights}, side, [1, weights.shape[1]])


def colour_segmenter(weights: np.ndarray, side: int = 8) -> bytes:
    """Scores (1, labels, side, side): each pixel's channels by weights (3, labels)."""
    kernel = weights.T.reshape(weights.shape[1], 3, 1, 1)
    return model([node("Conv", ["x", "w"], ["y"])], {"w": kernel}, side, [1, weights.shape[1], side, side])


def model(nodes: list[bytes], weights: dict[str, np.ndarray], side: int, output: list[int]) -> bytes:
    graph = b"".join(field(1, each) for each in nodes) + field(2, b"test")
    graph += b"".join(field(5, tensor(name, values)) for name, values in weights.items())
    graph += field(11, value_info("x", [1, 3, side, side])) + field(12, value_info("y", output))
    opset = field(1, b"") + number(2, OPSET)
    return number(1, IR) + field(7, graph) + field(8, opset)


def node(operator: str, inputs: list[str], outputs: list[str], **integers: int) -> bytes:
    out = b"".join(field(1, name.encode()) for name in inputs) + b"".join(field(2, name.encode()) for name in outputs)
    out += field(3, f"{operator}-{outputs[0]}".encode()) + field(4, operator.encode())
    for name, value in integers.items():
        out += field(5, field(1, name.encode()) + number(3, value) + number(20, 2))  # AttributeProto: name, i, INT
    return out


def tensor(name: str, values: np.ndarray) -> bytes:
    dimensions = b"".join(number(1, size) for size in values.shape)
    return dimensions + number(2, FLOAT) + field(8, name.encode()) + field(9, values.astype("<f4").tobytes())


def value_info(name: str, shape: list[int]) -> bytes:
    dimensions = b"".join(field(1, number(1, size)) for size in shape)
    return field(1, name.encode()) + field(2, field(1, number(1, FLOAT) + field(2, dimensions)))


def number(key: int, value: int) -> bytes:
    return varint(key << 3) + varint(value)


def field(key: int, content: bytes) -> bytes:
    return varint(key << 3 | 2) + varint(len(content)) + content


def varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out += struct.pack("B", value & 127 | 128)
        value >>= 7
    return out + struct.pack("B", value)

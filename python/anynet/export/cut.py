"""A program cut between its outputs: each part computes one more of them from what those before have left."""

from __future__ import annotations

import operator
from dataclasses import dataclass

import torch
from torch.export import ExportedProgram
from torch.fx import Graph, GraphModule, Node


@dataclass(frozen=True)
class Part:
    """A module with the names of its inputs and outputs, tensors all; an input is an image or an output of before."""

    module: GraphModule
    inputs: list[str]
    outputs: list[str]


def whole(program: ExportedProgram, outputs: list[str]) -> Part:
    module = _module(program)
    return Part(module, [node.name for node in module.graph.find_nodes(op="placeholder")], outputs)


def cut(program: ExportedProgram, outputs: list[str]) -> list[Part]:
    """One part for each of the program's outputs, which get these names. A part's first output is the program's."""
    module = _module(program)
    (returned,) = module.graph.output_node().args
    assert isinstance(returned, (tuple, list))
    results = [result for result in returned if isinstance(result, Node)]
    part_of = _assign(results)
    names = dict(zip(results, outputs, strict=True))
    parts = []
    for k, result in enumerate(results):
        later = [n for n in part_of if part_of[n] == k and n is not result and _is_used_after(n, k, part_of)]
        parts.append(_part(module, k, [result, *later], part_of, names))
    return parts


def _module(program: ExportedProgram) -> GraphModule:
    """Without operators that change their arguments, which may lie in another part."""
    module = program.run_decompositions({}).module(check_guards=False)
    assert isinstance(module, GraphModule)
    module.graph.eliminate_dead_code()
    module.recompile()
    return module


def _assign(results: list[Node]) -> dict[Node, int]:
    """The first part that needs a node, of all that compute something, in the graph's order."""
    part_of: dict[Node, int] = {}
    for k, result in enumerate(results):
        waiting = [result]
        while waiting:
            node = waiting.pop()
            if node.op == "call_function" and node not in part_of:
                part_of[node] = k
                waiting += node.all_input_nodes
    for node in results[0].graph.nodes:
        if node in part_of and node.target is operator.getitem:  # an element goes with its list, which is no tensor
            source = node.args[0]
            assert isinstance(source, Node)
            part_of[node] = part_of[source]
    return {node: part_of[node] for node in results[0].graph.nodes if node in part_of}


def _is_used_after(node: Node, part: int, part_of: dict[Node, int]) -> bool:
    return any(part_of.get(user, part) > part for user in node.users)


def _part(module: GraphModule, k: int, results: list[Node], part_of: dict[Node, int], names: dict[Node, str]) -> Part:
    graph = Graph()
    copies: dict[Node, Node] = {}
    inputs: list[str] = []
    own = [node for node in module.graph.nodes if part_of.get(node) == k]
    for node in own:
        for source in node.all_input_nodes:
            if source not in copies and source.op == "get_attr":
                copies[source] = graph.node_copy(source)
            elif source not in copies and part_of.get(source, -1) < k:
                inputs.append(names.get(source, source.name))
                copies[source] = graph.placeholder(inputs[-1])
                copies[source].meta = source.meta
    for node in own:
        copies[node] = graph.node_copy(node, copies.__getitem__)
    graph.output(tuple(copies[node] for node in results))
    part = GraphModule(module, graph)
    part.graph.lint()
    return Part(part, inputs, [names.get(node, node.name) for node in results])


def run(parts: list[Part], images: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """What the parts compute, one after the other, by name: the images' included."""
    values = dict(images)
    for part in parts:
        values |= zip(part.outputs, part.module(*[values[name] for name in part.inputs]), strict=True)
    return values

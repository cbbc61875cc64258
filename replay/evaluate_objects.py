"""Judging the objects that a map tells apart by those of the log's labelled mesh."""

from __future__ import annotations

import numpy as np

from proground_log.evaluation.instance_scores import InstanceScores, score_instances
from proground_log.evaluation.label_lists import read_labelled_mesh
from proground_log.log.reader import LogReader
from proground_log.log.topics import MESH_ATTACHMENT
from proground_log.mapping.map_file import NeuralMap
from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.perception.of_log import prompt_of
from proground_log.query.objects import object_of_vertices
from replay.evaluate_semantics import BACKGROUND
from replay.objects import surface_of

IOUS = (0.25, 0.5)


def instance_scores(content: NeuralMap, voxel_m: float, reader: LogReader) -> InstanceScores | None:
    """Match the objects of a map to the true ones; see `score_instances`.

    A true object has the class of the task's prompt that its label means, by name or as a synonym
    in the built-in texts. Objects of other classes, walls, floors and ceilings are not judged.

    Args:
        content: a map with semantics and a surface.
        voxel_m: voxels of the surface that is asked.
        reader: the log.

    Returns:
        None where the log has no mesh that tells objects apart.
    """
    attachment = reader.attachment(MESH_ATTACHMENT)
    if attachment is None or not reader.label_names or content.semantics is None:
        return None
    points_m, labels, numbers = read_labelled_mesh(attachment, where=reader.path)
    if numbers is None:
        return None
    prompts = content.semantics.description.task.prompts
    prompt_of_meaning = {_meaning(prompt): prompt for prompt in reversed(prompts)}
    class_of = {
        label: prompt_of_meaning.get(_meaning(name), "")
        for label, name in reader.label_names.items()
        if label > 0 and name.lower() not in BACKGROUND
    }
    judged = np.isin(labels, [label for label, name in sorted(class_of.items()) if name])
    _, firsts, objects = np.unique(numbers[judged], return_index=True, return_inverse=True)
    true_objects = np.full(len(labels), -1)
    true_objects[judged] = objects
    surface = surface_of(content, voxel_m, reader, reader.path)
    found, vertices_m = surface.objects(), surface.mesh.vertices_m
    return score_instances(
        points_m,
        true_objects,
        [class_of[int(label)] for label in labels[judged][firsts]],
        vertices_m,
        object_of_vertices(found, len(vertices_m)),
        [thing.label for thing in found],
        ious=IOUS,
    )


def instance_table(scores: InstanceScores) -> dict[str, float]:
    """The figures by name, percent; macro is the mean over the classes that are there."""
    table = {
        "true_objects": float(scores.total.true),
        "found_objects": float(scores.total.found),
    }
    for iou in IOUS:
        at = f"at_iou_{round(100 * iou)}_percent"
        table[f"object_precision_{at}"] = 100 * scores.total.precision(iou)
        table[f"object_recall_{at}"] = 100 * scores.total.recall(iou)
        table[f"object_f1_{at}"] = 100 * scores.total.f1(iou)
        table[f"object_f1_macro_{at}"] = 100 * scores.macro_f1(iou)
    return table


def _meaning(name: str) -> str:
    """What synonyms have in common; a name that the built-in texts do not know is its own."""
    texts = BuiltinTexts()
    return texts.concept(name) if texts.knows(name) else prompt_of(name)

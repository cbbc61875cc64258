"""Judging the objects that a map tells apart by those of the log's labelled mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from proground_log.evaluation.instance_scores import (
    InstanceScores,
    find_crowds,
    score_instances,
)
from proground_log.evaluation.label_lists import read_labelled_mesh
from proground_log.evaluation.semantics import BACKGROUND
from proground_log.log.topics import MESH_ATTACHMENT
from proground_log.perception.builtin_texts import BuiltinTexts
from proground_log.perception.of_log import prompt_of
from proground_log.query.objects import object_of_vertices
from proground_log.query.surface import Surface

IOUS = (0.25, 0.5)


@dataclass(frozen=True)
class ObjectScores:
    """How well a map tells objects apart.

    Args:
        alone: without those in crowds, which no surface of its voxels could tell apart.
        crowded: with them.
        in_crowds: how many true objects stand in crowds.
    """

    alone: InstanceScores
    crowded: InstanceScores
    in_crowds: int


def object_scores(surface: Surface) -> ObjectScores | None:
    """Match the objects of a map to the true ones; see `score_instances`.

    A true object has the class of the task's prompt that its label means, by name or as a synonym
    in the built-in texts. Objects of other classes, walls, floors and ceilings are not judged.

    Args:
        surface: of a map with meaning, with its log.

    Returns:
        None where the log has no mesh that tells objects apart.
    """
    reader = surface.run.log
    attachment = reader.attachment(MESH_ATTACHMENT)
    if attachment is None or not reader.label_names:
        return None
    points_m, labels, numbers = read_labelled_mesh(attachment, where=reader.path)
    if numbers is None:
        return None
    prompts = surface.description.task.prompts
    prompt_of_meaning = {_meaning(prompt): prompt for prompt in reversed(prompts)}
    class_of = {
        label: prompt_of_meaning.get(_meaning(name), "")
        for label, name in reader.label_names.items()
        if label > 0 and name.lower() not in BACKGROUND
    }
    judged = np.isin(labels, [label for label, name in sorted(class_of.items()) if name])
    _, firsts, members = np.unique(numbers[judged], return_index=True, return_inverse=True)
    true_objects = np.full(len(labels), -1)
    true_objects[judged] = members
    true_classes = [class_of[int(label)] for label in labels[judged][firsts]]
    crowds = find_crowds(points_m, true_objects, true_classes, surface.voxel_m)
    objects, vertices_m = surface.objects, surface.mesh.vertices_m
    of_vertices = object_of_vertices(objects, len(vertices_m))
    names = [thing.label for thing in objects]
    truth, found = (points_m, true_objects, true_classes), (vertices_m, of_vertices, names)
    return ObjectScores(
        alone=score_instances(*truth, *found, crowds=crowds, ious=IOUS),
        crowded=score_instances(*truth, *found, ious=IOUS),
        in_crowds=len(crowds),
    )


def object_table(scores: ObjectScores) -> dict[str, float]:
    """The figures by name, percent; macro is the mean over the classes that are there."""
    alone = scores.alone
    table = {
        "true_objects": float(alone.total.true),
        "found_objects": float(alone.total.found),
    }
    for iou in IOUS:
        at = f"at_iou_{round(100 * iou)}_percent"
        table[f"object_precision_{at}"] = 100 * alone.total.precision(iou)
        table[f"object_recall_{at}"] = 100 * alone.total.recall(iou)
        table[f"object_f1_{at}"] = 100 * alone.total.f1(iou)
        table[f"object_f1_macro_{at}"] = 100 * alone.macro_f1(iou)
    if scores.in_crowds:
        table["objects_in_crowds"] = float(scores.in_crowds)
        for iou in IOUS:
            name = f"object_f1_with_crowds_at_iou_{round(100 * iou)}_percent"
            table[name] = 100 * scores.crowded.total.f1(iou)
    return table


def _meaning(name: str) -> str:
    """What synonyms have in common; a name that the built-in texts do not know is its own."""
    texts = BuiltinTexts()
    return texts.concept(name) if texts.knows(name) else prompt_of(name)

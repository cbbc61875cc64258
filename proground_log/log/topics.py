"""What stands in a log: topics, coordinate frames, metadata and attachments, by name."""

from __future__ import annotations

SCHEMA_VERSION = "1"
"""Version of this contract; a reader refuses any other."""

COLOR = "/camera/color/image"
COLOR_INFO = "/camera/color/camera_info"
DEPTH = "/camera/depth/image"
DEPTH_INFO = "/camera/depth/camera_info"
TF = "/tf"
TF_STATIC = "/tf_static"
LABELS = "/ground_truth/labels"
INSTANCES = "/ground_truth/instances"
LABELS_PREVIEW = "/ground_truth/labels_preview"
REGIONS = "/perception/regions"
REGIONS_PREVIEW = "/perception/preview"

PERCEPTION = frozenset({REGIONS, REGIONS_PREVIEW})
"""What `pglog perceive` adds to a log, and replaces where it is there."""

WORLD_FRAME = "world"
COLOR_FRAME = "camera_color_optical_frame"
DEPTH_FRAME = "camera_depth_optical_frame"

ORIGIN_METADATA = "proground.origin"
RECORDING_METADATA = "proground.recording"
TASK_METADATA = "proground.task"
LABEL_NAMES_ATTACHMENT = "label_names.json"
MESH_ATTACHMENT = "ground_truth_mesh.ply"

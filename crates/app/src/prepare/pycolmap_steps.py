"""Runs a step of structure from motion with pycolmap, given the options of the program colmap.

In: a command of colmap and its options, as arguments; `describe` prints the version and what this
version can do, one word a line. Out: what the command leaves: a database, models in a folder.
Signatures and names that differ between versions are asked for, not assumed.
"""
import os
import sys

# The folder that the program was started in is no place for modules.
if sys.path and sys.path[0] == "":
    del sys.path[0]

import pycolmap


def accepts(function, name):
    """Returns whether a function has a parameter of this name."""
    return f"{name}:" in (function.__doc__ or "")


def types(name):
    """Returns the members of an enumeration of pycolmap; none in versions without it."""
    return getattr(getattr(pycolmap, name, None), "__members__", {})


def has_aliked():
    """Returns whether features of ALIKED are built in."""
    options = getattr(pycolmap, "FeatureExtractionOptions", None)
    return "ALIKED_N16ROT" in types("FeatureExtractorType") and hasattr(options, "aliked")


def describe():
    print("pycolmap " + pycolmap.__version__)
    if has_aliked():
        print("aliked")
    if hasattr(pycolmap, "global_mapping"):
        print("global")
    if hasattr(pycolmap, "match_image_pairs"):
        print("pairs")
    if hasattr(pycolmap, "apply_rig_config"):
        print("rigs")


def read_options(words):
    """Returns options by name, without dashes."""
    names = [word.removeprefix("--") for word in words[::2]]
    return dict(zip(names, words[1::2]))


def device(function):
    """Returns the argument that keeps a function on the processor."""
    return {"device": pycolmap.Device.cpu} if accepts(function, "device") else {}


def extract(options):
    function = pycolmap.extract_features
    with open(options["image_list_path"], encoding="utf-8") as file:
        names = [line for line in file.read().split("\n") if line]
    reader = pycolmap.ImageReaderOptions()
    model = options["ImageReader.camera_model"]
    arguments = {"database_path": options["database_path"], "image_path": options["image_path"]}
    arguments["image_names" if accepts(function, "image_names") else "image_list"] = names
    arguments["camera_mode"] = pycolmap.CameraMode.SINGLE
    # Versions before 3.12 have the model as an argument.
    if accepts(function, "camera_model"):
        arguments["camera_model"] = model
    else:
        reader.camera_model = model
    if "ImageReader.camera_params" in options:
        reader.camera_params = options["ImageReader.camera_params"]
    arguments["reader_options"] = reader
    kind = options.get("FeatureExtraction.type")
    if kind:
        extraction = pycolmap.FeatureExtractionOptions(types("FeatureExtractorType")[kind])
        arguments["extraction_options"] = extraction
    function(**arguments, **device(function))


def match(function, options, **more):
    arguments = {"database_path": options["database_path"], **more}
    kind = options.get("FeatureMatching.type")
    if kind:
        arguments["matching_options"] = pycolmap.FeatureMatchingOptions(types("FeatureMatcherType")[kind])
    function(**arguments, **device(function))


def match_pairs(options):
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = options["match_list_path"]
    match(pycolmap.match_image_pairs, options, pairing_options=pairing)


def configure_rigs(options):
    configs = pycolmap.read_rig_config(options["rig_config_path"])
    # Databases are opened by a function since 4.0.
    database = getattr(pycolmap.Database, "open", pycolmap.Database)(options["database_path"])
    pycolmap.apply_rig_config(configs, database)
    database.close()


def reconstruct(function, options):
    arguments = {name: options[name] for name in ("database_path", "image_path", "output_path")}
    os.makedirs(arguments["output_path"], exist_ok=True)
    choices = {name.removeprefix("Mapper."): value for name, value in options.items() if name.startswith("Mapper.")}
    if choices:
        arguments["options"] = pycolmap.IncrementalPipelineOptions()
        for name, value in choices.items():
            setattr(arguments["options"], name, value != "0")
    if not function(**arguments):
        print("no model was found")


def main(words):
    command, options = words[0], read_options(words[1:])
    commands = {
        "describe": describe,
        "feature_extractor": lambda: extract(options),
        "rig_configurator": lambda: configure_rigs(options),
        "exhaustive_matcher": lambda: match(pycolmap.match_exhaustive, options),
        "sequential_matcher": lambda: match(pycolmap.match_sequential, options),
        "matches_importer": lambda: match_pairs(options),
        "mapper": lambda: reconstruct(pycolmap.incremental_mapping, options),
        "global_mapper": lambda: reconstruct(pycolmap.global_mapping, options),
    }
    commands[command]()


main(sys.argv[1:])

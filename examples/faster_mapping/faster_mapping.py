"""COLMAP's incremental mapper with bundle's adjuster: faster_mapping.py DATABASE OUTPUT_FOLDER."""

import functools
import sys
from pathlib import Path

import pycolmap

import bundle

options = pycolmap.IncrementalPipelineOptions(random_seed=0)
limits, tracks = options.get_mapper(), options.get_triangulation()
worst = limits.filter_max_reproj_error, limits.filter_min_tri_angle
with pycolmap.Database.open(sys.argv[1]) as database:
    pipeline = pycolmap.IncrementalPipeline(options, database, pycolmap.ReconstructionManager())
mapper, model = pycolmap.IncrementalMapper(pipeline.database_cache), pycolmap.Reconstruction()
mapper.begin_reconstruction(model)
extend, filters = mapper.triangulator, mapper.observation_manager


def refine_locally(image_id):
    """Adjust a new image and its neighbours, as COLMAP's iterative_local_refinement."""
    adjustment = options.get_local_bundle_adjustment()
    for _ in range(options.ba_local_max_refinements):
        config, new = pycolmap.BundleAdjustmentConfig(), mapper.get_modified_points3D()
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.THREE_POINTS)
        for near in (image_id, *mapper.find_local_bundle(limits, image_id)):
            for data in model.image(near).frame.image_ids:
                config.add_image(data.id)
        for key, count in mapper.num_reg_images_per_camera.items():
            if sum(model.image(image).camera_id == key for image in config.images) < count:
                config.set_constant_cam_intrinsics(key)
        short = {key for key in new if model.point3D(key).track.length() <= 15}
        for key in short:
            config.add_variable_point(key)
        seen = bundle.bundle_adjustment(model, adjustment, config).num_residuals / 2
        moved = extend.merge_tracks(tracks, short) + extend.complete_tracks(tracks, short)
        moved += extend.complete_image(tracks, image_id) + filters.filter_points3D(*worst, new)
        moved += filters.filter_points3D_in_images(*worst, set(config.images))
        if moved < options.ba_local_max_refinement_change * seen:
            break
        adjustment.ceres.loss_function_type = pycolmap.LossFunctionType.TRIVIAL
    mapper.clear_modified_points3D()


def refine_globally():
    """Adjust all images, as COLMAP's iterative_global_refinement."""
    mapper.complete_and_merge_tracks(tracks)
    mapper.retriangulate(tracks)
    for _ in range(options.ba_global_max_refinements):
        seen = model.compute_num_observations()
        bundle.bundle_adjustment(model, options.get_global_bundle_adjustment())
        model.normalize()
        moved = mapper.complete_and_merge_tracks(tracks) + mapper.filter_points(limits)
        if moved < options.ba_global_max_refinement_change * seen:
            break
    mapper.filter_frames(limits)


pipeline.initialize_reconstruction(mapper, limits, model)
register = functools.partial(mapper.register_next_image, limits)
last = model.num_reg_frames(), model.num_points3D()
while found := next(filter(register, mapper.find_next_images(limits, False)), None):
    for data in model.image(found).frame.image_ids:
        mapper.triangulate_image(tracks, data.id)
    refine_locally(found)
    if pipeline.check_run_global_refinement(model, *last):
        refine_globally()
        last = model.num_reg_frames(), model.num_points3D()
    print(f"{model.num_reg_images()} images, {model.num_points3D()} points", file=sys.stderr)
refine_globally()
Path(sys.argv[2]).mkdir(parents=True, exist_ok=True)
model.write(sys.argv[2])

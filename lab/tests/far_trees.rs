//! Trees beyond the range of per-tree culling: none in view is left out, they stand where single
//! ones would, and those without room are counted.

use client::cache::ChunkCache;
use client::camera::Projection;
use client::features::vegetation::{Cull, VegetationSettings};
use client::gpu::{Gpu, Image, OffscreenTarget, offscreen};
use client::lod::select;
use client::renderer::{RenderOptions, Renderer};
use client::scene::Scene;
use client::settings::RenderSettings;
use client::view::ViewParams;
use terrain::{Land, lod};

const SIZE: (u32, u32) = (320, 180);
const SLOTS: u32 = 2_000;

/// Over a wooded plain towards mountains; low over hills; from above.
const CAMERAS: [&str; 3] = ["720,160,1700,0,-8", "-2200,60,-900,70,-3", "720,900,2600,10,-35"];

/// Trees alone, without wind, which would move near ones.
const TREES: VegetationSettings = VegetationSettings {
    density: 0,
    trees: 2,
    wind: 0.0,
    tree_range_m: 5_000.0,
    single_trees_m: 600.0,
    ..VegetationSettings::STANDARD
};

/// The best adapter; `None`, with the reason printed, where there is none and none is required.
fn open() -> Option<Gpu> {
    match Gpu::open_blocking() {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
            eprintln!("SKIPPED: {error}");
            None
        }
    }
}

/// A renderer and the world of one camera.
struct Woods {
    gpu: Gpu,
    renderer: Renderer,
    target: OffscreenTarget,
    world: ChunkCache,
    view: ViewParams,
}

impl Woods {
    fn open(camera: &str) -> Option<Self> {
        let gpu = open()?;
        let options = RenderOptions {
            scene: Scene::Island,
            size: SIZE,
            samples: 1,
            anisotropy: 1,
            format: offscreen::IMAGE_FORMAT,
            slots: SLOTS,
            clipmap_texels: 256,
        };
        let mut renderer = Renderer::new(&gpu, &options);
        let target = OffscreenTarget::new(&gpu.device, SIZE.0, SIZE.1);
        let view = ViewParams {
            pose: camera.parse().expect("a pose"),
            projection: Projection { fov_deg: 60.0, width: SIZE.0, height: SIZE.1 },
            view_distance_m: 8_000,
            tolerance_px: 4.0,
            time_s: 0.0,
            settings: RenderSettings::default(),
        };
        let land = Land::new(1);
        let mut world = ChunkCache::new(SLOTS);
        for needed in lod::select(&land, &view.viewer(), usize::MAX) {
            world.insert(land.chunk(needed.key));
        }
        world.residents().for_each(|chunk| renderer.upload(&gpu, chunk));
        Some(Self { gpu, renderer, target, world, view })
    }

    /// A picture, and what was drawn and lost of plants. `room` replaces the capacity for far
    /// trees.
    fn picture(&mut self, plants: VegetationSettings, room: Option<u32>) -> (Image, [u32; 2]) {
        let view = ViewParams { settings: RenderSettings { plants, ..self.view.settings }, ..self.view };
        let selection = select(&mut self.world, &view.viewer());
        let mut frame = view.frame(Scene::Island, &self.world, &selection);
        let far = frame.plants.as_mut().and_then(|plants| plants.far_trees.as_mut());
        if let (Some(far), Some(room)) = (far, room) {
            far.params.room = room;
        }
        self.renderer.finish_shading(&self.gpu, &frame).expect("the GPU works");
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.renderer.draw(&self.gpu, &frame, &mut encoder, &self.target.view);
        self.gpu.queue.submit([encoder.finish()]);
        let picture = self.target.read(&self.gpu).expect("the GPU works");
        let stats = self.renderer.vegetation().map(|plants| plants.read_stats(&self.gpu));
        let stats = stats.expect("plants are on").expect("the GPU works");
        (picture, [stats.clumps, stats.clumps_lost + stats.blocks_lost])
    }
}

/// Mean difference of all channels, steps of 8 bits.
fn apart(one: &Image, other: &Image) -> f64 {
    let sum: u64 = one.rgba.iter().zip(&other.rgba).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    sum as f64 / one.rgba.len() as f64
}

#[test]
fn no_far_tree_in_view_is_left_out() {
    for camera in CAMERAS {
        let Some(mut woods) = Woods::open(camera) else { return };
        let (culled, [chosen, lost]) = woods.picture(TREES, None);
        let (all, [total, _]) = woods.picture(VegetationSettings { cull: Cull::Distance, ..TREES }, None);
        assert_eq!((lost, culled == all), (0, true), "{camera}: {chosen} of {total} trees");
        assert!(chosen < total, "{camera}: patches outside of the view are left out");
        // The control: a view without the far trees.
        let (near, _) = woods.picture(VegetationSettings { tree_range_m: 600.0, ..TREES }, None);
        assert!(near != culled, "{camera}: no far tree is seen");
    }
}

#[test]
fn far_trees_stand_where_single_ones_would() {
    let Some(mut woods) = Woods::open(CAMERAS[0]) else { return };
    let single = VegetationSettings { tree_range_m: 1_500.0, single_trees_m: 1_500.0, ..TREES };
    let (reference, _) = woods.picture(VegetationSettings { tree_range_m: 1_600.0, ..single }, None);
    let patches = VegetationSettings { tree_range_m: 1_600.0, single_trees_m: 400.0, ..TREES };
    let (by_patches, _) = woods.picture(patches, None);
    let (none, _) = woods.picture(VegetationSettings { tree_range_m: 400.0, ..TREES }, None);
    let (found, control) = (apart(&reference, &by_patches), apart(&reference, &none));
    eprintln!("by patches {found:.3}, without {control:.3}");
    assert!(found < 0.4 * control, "{found} {control}");
}

#[test]
fn far_trees_without_room_are_counted_and_the_nearest_stay() {
    let Some(mut woods) = Woods::open(CAMERAS[0]) else { return };
    let (whole, [all, none]) = woods.picture(TREES, None);
    let (cut, [kept, lost]) = woods.picture(TREES, Some(100));
    assert_eq!(none, 0);
    assert!(lost > 1_000 && kept + lost == all, "{kept} {lost} {all}");
    assert!(cut != whole, "trees are missing");
    let (again, counts) = woods.picture(TREES, Some(100));
    assert_eq!((again == cut, counts), (true, [kept, lost]), "the same trees again");
}

#[test]
fn woods_up_to_8_km_have_room_with_the_densest_preset() {
    for camera in CAMERAS {
        let Some(mut woods) = Woods::open(camera) else { return };
        let far = VegetationSettings { trees: 3, tree_range_m: 8_000.0, ..TREES };
        let (_, [drawn, lost]) = woods.picture(far, None);
        eprintln!("{camera}: {drawn} trees, {lost} without room");
        assert!(drawn > 1_000 && lost == 0, "{camera}: {drawn} drawn, {lost} lost");
    }
}

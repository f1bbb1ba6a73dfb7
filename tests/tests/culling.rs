//! Vegetation culling on the GPU against the twin on the CPU, clump for clump.

use client::cache::ChunkCache;
use client::features::terrain::pool::ChunkPool;
use client::features::vegetation::gpu_cull::{CullBuffers, CullPasses, CullStats};
use client::features::vegetation::{Cull, VegetationSettings};
use client::gpu::Gpu;
use client::lod::select;
use client::settings::RenderSettings;
use client::view::ViewParams;
use lab::gpu_probes::cpu_cull::{VisibleClump, cull_on_cpu};
use terrain::{Land, lod};
use tests::places::{MEADOW, VALLEY, moved};

const SLOTS: u32 = 1500;

/// A view with settings of the vegetation.
fn view(camera: &str, vegetation: VegetationSettings) -> ViewParams {
    let view = tests::view_at(camera, (640, 360), 3000, 2.0);
    ViewParams { settings: RenderSettings { plants: vegetation, ..view.settings }, ..view }
}

/// The culling passes on the GPU, with buffers of a fixed capacity.
struct Field {
    gpu: Gpu,
    pool: ChunkPool,
    passes: CullPasses,
    grass: CullBuffers,
    trees: CullBuffers,
}

fn field(room: [u32; 3]) -> Option<Field> {
    let gpu = tests::open_gpu_or_skip()?;
    let pool = ChunkPool::new(&gpu.device, SLOTS);
    let passes = CullPasses::new(&gpu.device);
    let grass = passes.create_buffers(&gpu.device, &pool, (32_768, room), [18, 12, 6]);
    let trees = passes.create_buffers(&gpu.device, &pool, (32_768, room), [60, 12, 0]);
    Some(Field { gpu, pool, passes, grass, trees })
}

impl Field {
    /// The clumps of a frame that the GPU keeps: grass, then trees.
    fn choose(
        &mut self,
        world: &ChunkCache,
        view: &ViewParams,
        drawn: &[client::lod::Drawn],
    ) -> [(Vec<[u32; 4]>, CullStats); 2] {
        world.residents().for_each(|chunk| self.pool.upload(&self.gpu.queue, chunk));
        let plants = view.plants(world, drawn).expect("the view has vegetation");
        self.passes.prepare(&self.gpu.queue, &plants.grid);
        let passes = &mut self.passes;
        [(&self.grass, 0), (&self.trees, 1)].map(|(chosen, index)| {
            let mut encoder =
                self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            passes.record(&self.gpu, &plants, index, 1, chosen, &mut encoder);
            self.gpu.queue.submit([encoder.finish()]);
            let clumps = chosen.read(&self.gpu).unwrap().concat();
            (clumps, chosen.read_stats(&self.gpu).unwrap())
        })
    }
}

/// A clump without its normal, which is a float.
fn words(kept: &VisibleClump) -> [u32; 4] {
    let clump = &kept.clump;
    [clump.x as u32, clump.z as u32, clump.y as u32, clump.attributes]
}

fn without_normal(clump: &[u32; 4]) -> [u32; 4] {
    [clump[0] & 0xff_ffff, clump[1] & 0xff_ffff, clump[2], clump[3]]
}

#[test]
fn the_gpu_keeps_the_clumps_of_the_twin_in_the_same_order() {
    let Some(mut field) = field([20_000, 60_000, 90_000]) else { return };
    let land = Land::new(1);
    let few = VegetationSettings {
        density: 2,
        range_m: 160.0,
        tree_range_m: 800.0,
        ..VegetationSettings::STANDARD
    };
    let mut kept_by_path = Vec::new();
    for camera in [MEADOW.as_str(), &VALLEY, &moved(&MEADOW, 110.0, 10.0, -30.0)] {
        for cull in [Cull::Distance, Cull::Frustum, Cull::Noise, Cull::March, Cull::Exact, Cull::Hierarchical]
        {
            let view = view(camera, VegetationSettings { cull, ..few });
            let mut world = ChunkCache::new(SLOTS);
            world.set_land(Land::new(1));
            for needed in lod::select(&land, &view.viewer(), usize::MAX) {
                world.insert(land.chunk(needed.key));
            }
            let eye = view.pose.eye();
            let view = ViewParams { pose: view.pose.above(world.ground(eye.units[0], eye.units[2])), ..view };
            let selection = select(&mut world, &view.viewer());
            let plants = view.plants(&world, &selection.drawn).unwrap();
            let chosen = field.choose(&world, &view, &selection.drawn);
            for (species, (clumps, stats)) in plants.species.iter().zip(&chosen) {
                let mut twin = cull_on_cpu(&world, &plants, species);
                // The GPU writes each level of detail separately.
                twin.sort_by_key(|kept| kept.detail);
                assert_eq!((stats.blocks_lost, stats.clumps_lost), (0, 0), "{camera} {cull:?}");
                let expected: Vec<_> = twin.iter().map(words).collect();
                let found: Vec<_> = clumps.iter().map(without_normal).collect();
                assert_eq!(found.len(), expected.len(), "{camera} {cull:?}");
                assert!(found == expected, "{camera} {cull:?}: the same number of other clumps");
            }
            kept_by_path.push(chosen[0].0.len());
        }
    }
    assert!(kept_by_path.iter().any(|kept| *kept > 1000));
    for paths in kept_by_path.chunks(6) {
        assert!(paths[0] > paths[1] && paths[1] >= paths[4] && paths[4] >= paths[5], "{paths:?}");
    }
}

/// A frame with vegetation over complete land.
fn frame_of(
    world: &mut ChunkCache,
    view: &ViewParams,
    cull: Cull,
    vegetation: VegetationSettings,
) -> client::frame::FrameData {
    let settings = RenderSettings { plants: VegetationSettings { cull, ..vegetation }, ..view.settings };
    let view = ViewParams { settings, ..*view };
    let selection = select(world, &view.viewer());
    view.frame(client::scene::Scene::Island, world, &selection)
}

#[test]
fn culling_hidden_plants_changes_no_byte_of_the_picture() {
    let opened = lab::headless_renderer::HeadlessRenderer::open((192, 108), SLOTS);
    let Some(mut renderer) = tests::gpu_or_skip(opened) else { return };
    let land = Land::new(1);
    let vegetation = VegetationSettings {
        density: 3,
        range_m: 150.0,
        tree_range_m: 900.0,
        ..VegetationSettings::STANDARD
    };
    for camera in [MEADOW.as_str(), &VALLEY] {
        let view = view(camera, vegetation);
        let mut world = ChunkCache::new(SLOTS);
        world.set_land(Land::new(1));
        for needed in lod::select(&land, &view.viewer(), usize::MAX) {
            world.insert(land.chunk(needed.key));
        }
        let eye = view.pose.eye();
        let view = ViewParams { pose: view.pose.above(world.ground(eye.units[0], eye.units[2])), ..view };
        renderer.upload_world(&world);
        let mut picture = |cull, vegetation| {
            let frame = frame_of(&mut world, &view, cull, vegetation);
            renderer.picture(&frame).unwrap().rgba
        };
        let all = picture(Cull::Distance, vegetation);
        for cull in [Cull::Frustum, Cull::Exact, Cull::Hierarchical] {
            let differing = all.iter().zip(picture(cull, vegetation)).filter(|(a, b)| **a != *b).count();
            assert_eq!(differing, 0, "{camera} {cull:?}");
        }
        let bare = picture(Cull::Hierarchical, VegetationSettings::NONE);
        assert!(all != bare, "{camera}: plants are part of the picture");
    }
}

#[test]
fn a_visible_block_is_kept_for_the_configured_frames() {
    let Some(mut field) = field([20_000, 60_000, 90_000]) else { return };
    let land = Land::new(1);
    let vegetation = VegetationSettings {
        density: 2,
        range_m: 120.0,
        trees: 1,
        tree_range_m: 400.0,
        ..VegetationSettings::STANDARD
    };
    let mut kept = |stay: u32, camera: &str, frame: u32, world: &mut ChunkCache| {
        let view = view(camera, VegetationSettings { stay, cull: Cull::Frustum, ..vegetation });
        for needed in lod::select(&land, &view.viewer(), usize::MAX) {
            world.insert(land.chunk(needed.key));
        }
        let selection = select(world, &view.viewer());
        world.residents().for_each(|chunk| field.pool.upload(&field.gpu.queue, chunk));
        let plants = view.plants(world, &selection.drawn).unwrap();
        field.passes.prepare(&field.gpu.queue, &plants.grid);
        let mut encoder = field.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        field.passes.record(&field.gpu, &plants, 0, frame, &field.grass, &mut encoder);
        field.gpu.queue.submit([encoder.finish()]);
        field.grass.read_stats(&field.gpu).unwrap().blocks
    };
    let mut world = ChunkCache::new(SLOTS);
    world.set_land(Land::new(1));
    let (here, turned) = (&moved(&MEADOW, 70.0, 330.0, -10.0), &moved(&MEADOW, 70.0, 15.0, -10.0));
    let before = kept(3, here, 10, &mut world);
    let alone = kept(0, turned, 11, &mut world);
    let lingering = kept(3, turned, 12, &mut world);
    let gone = kept(3, turned, 40, &mut world);
    assert!(before > 50 && alone > 50);
    assert!(lingering > alone, "{lingering} {alone}");
    assert_eq!(gone, alone);
}

#[test]
fn zero_one_and_too_many_clumps_are_kept_and_counted() {
    let Some(mut field) = field([40, 40, 40]) else { return };
    let land = Land::new(1);
    let camera = &MEADOW;
    let mut choose = |range_m: f32| {
        let vegetation = VegetationSettings {
            density: 1,
            trees: 0,
            range_m,
            cull: Cull::Distance,
            ..VegetationSettings::STANDARD
        };
        let view = view(camera, vegetation);
        let mut world = ChunkCache::new(SLOTS);
        world.set_land(Land::new(1));
        for needed in lod::select(&land, &view.viewer(), usize::MAX) {
            world.insert(land.chunk(needed.key));
        }
        let eye = view.pose.eye();
        let view = ViewParams { pose: view.pose.above(world.ground(eye.units[0], eye.units[2])), ..view };
        let selection = select(&mut world, &view.viewer());
        let plants = view.plants(&world, &selection.drawn).unwrap();
        let mut twin = cull_on_cpu(&world, &plants, &plants.species[0]);
        twin.sort_by_key(|kept| kept.detail);
        world.residents().for_each(|chunk| field.pool.upload(&field.gpu.queue, chunk));
        field.passes.prepare(&field.gpu.queue, &plants.grid);
        let mut encoder = field.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        field.passes.record(&field.gpu, &plants, 0, 1, &field.grass, &mut encoder);
        field.gpu.queue.submit([encoder.finish()]);
        (twin, field.grass.read(&field.gpu).unwrap(), field.grass.read_stats(&field.gpu).unwrap())
    };
    // A range without any clump; then the least range with exactly one.
    let (twin, chosen, stats) = choose(0.05);
    assert_eq!((twin.len(), chosen.concat().len(), stats.clumps, stats.clumps_lost), (0, 0, 0, 0));
    let one = (1..200).map(|step| 0.05 * step as f32).map(&mut choose).find(|(twin, ..)| !twin.is_empty());
    let (twin, chosen, stats) = one.expect("some grass within 10 m");
    assert_eq!((twin.len(), stats.clumps, stats.clumps_lost), (1, 1, 0));
    assert_eq!(without_normal(&chosen.concat()[0]), words(&twin[0]));
    // The buffers are full: they hold the nearest clumps, the rest is counted, and no other memory
    // is written.
    let (twin, chosen, stats) = choose(150.0);
    let expected = |level: u32| twin.iter().filter(|kept| kept.detail == level).count();
    let room = [0, 1, 2].map(|level| expected(level).min(40));
    assert_eq!(chosen.each_ref().map(Vec::len), room);
    assert_eq!(stats.clumps as usize, room.iter().sum::<usize>());
    assert_eq!(stats.clumps_lost as usize, twin.len() - stats.clumps as usize);
    assert!(stats.clumps_lost > 100, "control: {stats:?}");
    for (level, clumps) in chosen.iter().enumerate() {
        let nearest: Vec<_> =
            twin.iter().filter(|kept| kept.detail as usize == level).take(40).map(words).collect();
        assert_eq!(clumps.iter().map(without_normal).collect::<Vec<_>>(), nearest);
    }
}

//! Plants as the GPU chooses them against the twin on the CPU, clump for clump.

use client::camera::Lens;
use client::frame::Shot;
use client::looks::Looks;
use client::plants::kept::{Kept, kept_of};
use client::plants::{Cull, PlantKnobs};
use client::render::cull::{Chosen, CullPasses, Told};
use client::render::pool::ChunkPool;
use client::render::{Gpu, gpu};
use client::world::{World, select};
use terrain::{Land, lod};

const SLOTS: u32 = 1500;

fn shot(camera: &str, knobs: PlantKnobs) -> Shot {
    Shot {
        pose: camera.parse().unwrap(),
        lens: Lens { fov_deg: 60.0, width: 640, height: 360 },
        view_distance_m: 3000,
        tolerance_px: 2.0,
        time_s: 0.0,
        looks: Looks { plants: knobs, ..Looks::default() },
    }
}

/// Something that chooses plants on the GPU.
struct Field {
    gpu: Gpu,
    pool: ChunkPool,
    passes: CullPasses,
    grass: Chosen,
    trees: Chosen,
}

fn field(room: [u32; 3]) -> Option<Field> {
    let gpu = pollster::block_on(Gpu::open(gpu::instance(None), None)).ok()?;
    let pool = ChunkPool::new(&gpu.device, SLOTS);
    let passes = CullPasses::new(&gpu.device);
    let grass = passes.room_for(&gpu.device, &pool, room, [18, 12, 6]);
    let trees = passes.room_for(&gpu.device, &pool, room, [60, 12, 0]);
    Some(Field { gpu, pool, passes, grass, trees })
}

impl Field {
    /// What the GPU keeps of a frame: of grass, then of trees.
    fn choose(
        &self,
        world: &World,
        shot: &Shot,
        drawn: &[client::world::Drawn],
    ) -> [(Vec<[u32; 4]>, Told); 2] {
        world.residents().for_each(|chunk| self.pool.upload(&self.gpu.queue, chunk));
        let plants = shot.plants(world, drawn).expect("something grows");
        self.passes.prepare(&self.gpu.queue, &plants.square);
        [(&self.grass, 0), (&self.trees, 1)].map(|(chosen, index)| {
            let mut encoder =
                self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            self.passes.record(&self.gpu.queue, &plants, index, 1, chosen, &mut encoder);
            self.gpu.queue.submit([encoder.finish()]);
            let clumps = chosen.read(&self.gpu).unwrap().concat();
            (clumps, chosen.told(&self.gpu).unwrap())
        })
    }
}

/// A clump without its normal, which is a float's business.
fn words(kept: &Kept) -> [u32; 4] {
    let clump = &kept.clump;
    [clump.x as u32, clump.z as u32, clump.y as u32, clump.looks]
}

fn without_normal(clump: &[u32; 4]) -> [u32; 4] {
    [clump[0] & 0xff_ffff, clump[1] & 0xff_ffff, clump[2], clump[3]]
}

#[test]
fn the_gpu_keeps_exactly_what_the_twin_keeps_in_the_same_order() {
    let Some(field) = field([20_000, 60_000, 90_000]) else { return };
    let land = Land::new(1);
    let few = PlantKnobs { density: 2, range_m: 160.0, tree_range_m: 800.0, ..PlantKnobs::STANDARD };
    let mut kept_by_path = Vec::new();
    for camera in ["-1700,60,900,70,-6", "300,60,900,200,-3", "-600,300,-600,10,-30"] {
        for cull in [Cull::Distance, Cull::Frustum, Cull::Noise, Cull::March, Cull::Exact, Cull::Hierarchical]
        {
            let shot = shot(camera, PlantKnobs { cull, ..few });
            let mut world = World::new(SLOTS);
            world.set_seed(1);
            for needed in lod::select(&land, &shot.viewer(), usize::MAX) {
                world.insert(land.chunk(needed.key));
            }
            let eye = shot.pose.eye();
            let shot = Shot { pose: shot.pose.above(world.ground(eye.units[0], eye.units[2])), ..shot };
            let selection = select(&mut world, &shot.viewer());
            let plants = shot.plants(&world, &selection.drawn).unwrap();
            let chosen = field.choose(&world, &shot, &selection.drawn);
            for (stand, (clumps, told)) in plants.stands.iter().zip(&chosen) {
                let mut twin = kept_of(&world, &plants, stand);
                // The GPU gathers each level of detail by itself.
                twin.sort_by_key(|kept| kept.detail);
                assert_eq!((told.blocks_lost, told.clumps_lost), (0, 0), "{camera} {cull:?}");
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

/// A frame of plants over land that is all here.
fn frame_of(world: &mut World, shot: &Shot, cull: Cull, knobs: PlantKnobs) -> client::frame::FrameData {
    let looks = Looks { plants: PlantKnobs { cull, ..knobs }, ..shot.looks };
    let shot = Shot { looks, ..*shot };
    let selection = select(world, &shot.viewer());
    shot.frame(client::scene::Scene::Island, world, &selection)
}

#[test]
fn a_picture_without_what_is_hidden_is_the_picture_with_it_byte_for_byte() {
    let Ok(mut studio) = lab::studio::Studio::open((192, 108), SLOTS) else { return };
    let land = Land::new(1);
    let knobs = PlantKnobs { density: 3, range_m: 150.0, tree_range_m: 900.0, ..PlantKnobs::STANDARD };
    for camera in ["-3900,36.5,1000,30,-2", "300,60,900,200,-3"] {
        let shot = shot(camera, knobs);
        let mut world = World::new(SLOTS);
        world.set_seed(1);
        for needed in lod::select(&land, &shot.viewer(), usize::MAX) {
            world.insert(land.chunk(needed.key));
        }
        let eye = shot.pose.eye();
        let shot = Shot { pose: shot.pose.above(world.ground(eye.units[0], eye.units[2])), ..shot };
        studio.furnish(&world);
        let mut picture = |cull, knobs| {
            let frame = frame_of(&mut world, &shot, cull, knobs);
            studio.picture(&frame).unwrap().rgba
        };
        let all = picture(Cull::Distance, knobs);
        for cull in [Cull::Frustum, Cull::Exact, Cull::Hierarchical] {
            let differing = all.iter().zip(picture(cull, knobs)).filter(|(a, b)| **a != *b).count();
            assert_eq!(differing, 0, "{camera} {cull:?}");
        }
        let bare = picture(Cull::Hierarchical, PlantKnobs::NONE);
        assert!(all != bare, "{camera}: plants are part of the picture");
    }
}

#[test]
fn a_block_that_was_seen_stays_as_long_as_it_is_told_to_and_no_longer() {
    let Some(field) = field([20_000, 60_000, 90_000]) else { return };
    let land = Land::new(1);
    let knobs =
        PlantKnobs { density: 2, range_m: 120.0, trees: 1, tree_range_m: 400.0, ..PlantKnobs::STANDARD };
    let kept = |stay: u32, camera: &str, frame: u32, world: &mut World| {
        let shot = shot(camera, PlantKnobs { stay, cull: Cull::Frustum, ..knobs });
        for needed in lod::select(&land, &shot.viewer(), usize::MAX) {
            world.insert(land.chunk(needed.key));
        }
        let selection = select(world, &shot.viewer());
        world.residents().for_each(|chunk| field.pool.upload(&field.gpu.queue, chunk));
        let plants = shot.plants(world, &selection.drawn).unwrap();
        field.passes.prepare(&field.gpu.queue, &plants.square);
        let mut encoder = field.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        field.passes.record(&field.gpu.queue, &plants, 0, frame, &field.grass, &mut encoder);
        field.gpu.queue.submit([encoder.finish()]);
        field.grass.told(&field.gpu).unwrap().blocks
    };
    let mut world = World::new(SLOTS);
    world.set_seed(1);
    let (here, turned) = ("-3900,60,1000,30,-10", "-3900,60,1000,75,-10");
    let before = kept(3, here, 10, &mut world);
    let alone = kept(0, turned, 11, &mut world);
    let lingering = kept(3, turned, 12, &mut world);
    let gone = kept(3, turned, 40, &mut world);
    assert!(before > 50 && alone > 50);
    assert!(lingering > alone, "{lingering} {alone}");
    assert_eq!(gone, alone);
}

#[test]
fn one_clump_none_and_more_than_there_is_room_for() {
    let Some(field) = field([40, 40, 40]) else { return };
    let land = Land::new(1);
    let camera = "-1700,60,900,70,-6";
    let mut choose = |range_m: f32| {
        let knobs =
            PlantKnobs { density: 1, trees: 0, range_m, cull: Cull::Distance, ..PlantKnobs::STANDARD };
        let shot = shot(camera, knobs);
        let mut world = World::new(SLOTS);
        world.set_seed(1);
        for needed in lod::select(&land, &shot.viewer(), usize::MAX) {
            world.insert(land.chunk(needed.key));
        }
        let eye = shot.pose.eye();
        let shot = Shot { pose: shot.pose.above(world.ground(eye.units[0], eye.units[2])), ..shot };
        let selection = select(&mut world, &shot.viewer());
        let plants = shot.plants(&world, &selection.drawn).unwrap();
        let mut twin = kept_of(&world, &plants, &plants.stands[0]);
        twin.sort_by_key(|kept| kept.detail);
        world.residents().for_each(|chunk| field.pool.upload(&field.gpu.queue, chunk));
        field.passes.prepare(&field.gpu.queue, &plants.square);
        let mut encoder = field.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        field.passes.record(&field.gpu.queue, &plants, 0, 1, &field.grass, &mut encoder);
        field.gpu.queue.submit([encoder.finish()]);
        (twin, field.grass.read(&field.gpu).unwrap(), field.grass.told(&field.gpu).unwrap())
    };
    // Too near for any clump to stand there; then as far as it takes to hold exactly one.
    let (twin, chosen, told) = choose(0.05);
    assert_eq!((twin.len(), chosen.concat().len(), told.clumps, told.clumps_lost), (0, 0, 0, 0));
    let one = (1..200).map(|step| 0.05 * step as f32).map(&mut choose).find(|(twin, ..)| !twin.is_empty());
    let (twin, chosen, told) = one.expect("some grass within 10 m");
    assert_eq!((twin.len(), told.clumps, told.clumps_lost), (1, 1, 0));
    assert_eq!(without_normal(&chosen.concat()[0]), words(&twin[0]));
    // The buffers are full: what there is room for is drawn, the rest is counted, and no other
    // memory is touched.
    let (twin, chosen, told) = choose(150.0);
    let wanted = |level: u32| twin.iter().filter(|kept| kept.detail == level).count();
    let room = [0, 1, 2].map(|level| wanted(level).min(40));
    assert_eq!(chosen.each_ref().map(Vec::len), room);
    assert_eq!(told.clumps as usize, room.iter().sum::<usize>());
    assert_eq!(told.clumps_lost as usize, twin.len() - told.clumps as usize);
    assert!(told.clumps_lost > 100, "the control: {told:?}");
    for (level, clumps) in chosen.iter().enumerate() {
        let nearest: Vec<_> =
            twin.iter().filter(|kept| kept.detail as usize == level).take(40).map(words).collect();
        assert_eq!(clumps.iter().map(without_normal).collect::<Vec<_>>(), nearest);
    }
}

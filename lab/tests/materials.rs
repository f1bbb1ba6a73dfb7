//! Baked materials, read back: that they tile, that their mips keep what they must, and that a
//! wrong material fails the same comparisons.

use client::features::materials::{
    CustomMaterial, CustomMaterials, MATERIAL_SIZE, MATERIAL_TEXELS, Materials,
};
use client::gpu;
use client::gpu::Gpu;
use client::settings::Tiling;
use lab::gpu_probes::tiling::{FIELD, Look, ProbeTiling};
use shaders::SHADERS;
use shaders::layout::{BakeTexel, MATERIALS};

/// The best adapter; `None`, with the reason printed, where there is none and none is required.
fn open() -> Option<Gpu> {
    match pollster::block_on(Gpu::open(gpu::instance(None), None)) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert!(std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none(), "a GPU is required: {error}");
            eprintln!("SKIPPED: {error}");
            None
        }
    }
}

fn bake(gpu: &Gpu, own: &CustomMaterials) -> Materials {
    Materials::new(&gpu.device, &gpu.queue, own, 1)
}

/// One level of one layer, as bytes without padding.
fn read(gpu: &Gpu, texture: &wgpu::Texture, layer: u32, level: u32) -> Vec<u8> {
    let side = MATERIAL_SIZE >> level;
    let row = side * texture.format().block_copy_size(None).unwrap();
    let stride = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(stride) * u64::from(side),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    encoder.copy_texture_to_buffer(
        wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: level,
            origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
            aspect: wgpu::TextureAspect::All,
        },
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(stride),
                rows_per_image: None,
            },
        },
        wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 1 },
    );
    gpu.queue.submit([encoder.finish()]);
    buffer.map_async(wgpu::MapMode::Read, .., |outcome| outcome.unwrap());
    gpu.wait().unwrap();
    let mapped = buffer.get_mapped_range(..).unwrap();
    mapped.chunks_exact(stride as usize).flat_map(|line| &line[..row as usize]).copied().collect()
}

/// IEEE 754 binary16, of which textures hold no infinities.
fn half(bits: u16) -> f32 {
    let (exponent, mantissa) = (i32::from(bits >> 10 & 31), f32::from(bits & 1023));
    let magnitude = if exponent == 0 {
        mantissa / 1024.0 * 2f32.powi(-14)
    } else {
        (1.0 + mantissa / 1024.0) * 2f32.powi(exponent - 15)
    };
    if bits >> 15 == 1 { -magnitude } else { magnitude }
}

/// Albedo and height.
fn colours(gpu: &Gpu, materials: &Materials, layer: u32, level: u32) -> Vec<[f32; 4]> {
    let bytes = read(gpu, &materials.colours, layer, level);
    let channel = |texel: &[u8], at: usize| half(u16::from_le_bytes([texel[2 * at], texel[2 * at + 1]]));
    bytes.chunks_exact(8).map(|texel| [0, 1, 2, 3].map(|at| channel(texel, at))).collect()
}

/// Unit normal (u, v, up), roughness and occlusion.
fn shapes(gpu: &Gpu, materials: &Materials, layer: u32, level: u32) -> Vec<([f32; 3], f32, f32)> {
    let bytes = read(gpu, &materials.shapes, layer, level);
    let shape = |texel: &[u8]| {
        let [u, v] = [texel[0], texel[1]].map(|byte| (f32::from(byte) - 128.0) / 127.0);
        let up = (1.0 - u * u - v * v).max(0.0).sqrt();
        ([u, v, up], f32::from(texel[2]) / 255.0, f32::from(texel[3]) / 255.0)
    };
    bytes.chunks_exact(4).map(shape).collect()
}

fn heights(gpu: &Gpu, materials: &Materials, layer: u32) -> Vec<f32> {
    read(gpu, &materials.heights, layer, 0)
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
        .collect()
}

fn mean(values: impl ExactSizeIterator<Item = f32>) -> f32 {
    let count = values.len() as f64;
    (values.map(f64::from).sum::<f64>() / count) as f32
}

/// Mean difference of neighbours across the seam over that inside, the larger of both directions: 1
/// for what tiles.
fn seam(map: &[f32]) -> f32 {
    let side = MATERIAL_SIZE as usize;
    let row = |y: usize| &map[y * side..(y + 1) * side];
    let column = |x: usize| (0..side).map(move |y| map[y * side + x]);
    let rows = |a: usize, b: usize| mean(row(a).iter().zip(row(b)).map(|(a, b)| (a - b).abs()));
    let columns = |a: usize, b: usize| {
        mean(column(a).zip(column(b)).map(|(a, b)| (a - b).abs()).collect::<Vec<_>>().into_iter())
    };
    // The seam may be rougher than the mean of all rows, but not than all of some.
    let inside = |difference: &dyn Fn(usize, usize) -> f32| {
        (8..side - 8).step_by(8).map(|at| difference(at, at + 1)).fold(0.0, f32::max)
    };
    (rows(side - 1, 0) / inside(&rows)).max(columns(side - 1, 0) / inside(&columns))
}

#[test]
fn every_set_tiles_and_half_of_one_does_not() {
    let Some(gpu) = open() else { return };
    let materials = bake(&gpu, &CustomMaterials::default());
    let side = MATERIAL_SIZE as usize;
    for (layer, name) in MATERIALS.iter().enumerate() {
        let map = heights(&gpu, &materials, layer as u32);
        assert!(seam(&map) <= 1.1, "{name}: {}", seam(&map));
        // A quarter, stretched to the whole without interpolation: its edges do not meet.
        let cut: Vec<f32> = (0..side * side).map(|at| map[at / side / 2 * side + at % side / 2]).collect();
        let broken = seam(&cut);
        assert!(broken > 1.1, "{name}: the control passed with {broken}");
    }
}

/// The mean albedo that `shared/material_sets.wesl` states of a set.
fn stated_mean(layer: usize) -> [f32; 3] {
    let table = SHADERS.bake_materials.wgsl.split("const MATERIAL_SETS").nth(1).expect("the table");
    let triple =
        table.split("vec3f(").nth(layer + 1).and_then(|rest| rest.split(')').next()).expect("a colour");
    let mut parts = triple.split(',').map(|part| part.trim().parse().expect("a number"));
    std::array::from_fn(|_| parts.next().expect("three numbers"))
}

#[test]
fn normals_heights_and_colours_are_in_range() {
    let Some(gpu) = open() else { return };
    let materials = bake(&gpu, &CustomMaterials::default());
    for (layer, name) in MATERIALS.iter().enumerate() {
        let layer = layer as u32;
        let shapes = shapes(&gpu, &materials, layer, 0);
        let up = mean(shapes.iter().map(|(normal, ..)| normal[2]));
        let across = [0, 1].map(|axis| mean(shapes.iter().map(|(normal, ..)| normal[axis])));
        let open_sky = mean(shapes.iter().map(|(.., occlusion)| *occlusion));
        let map = heights(&gpu, &materials, layer);
        let (low, high) = map.iter().fold((1f32, 0f32), |(low, high), h| (low.min(*h), high.max(*h)));
        let last = colours(&gpu, &materials, layer, MATERIAL_SIZE.ilog2())[0];
        for (found, stated) in last.into_iter().zip(stated_mean(layer as usize)) {
            assert!(
                (found / stated - 1.0).abs() < 0.03,
                "{name}: its mean is {last:.4?}, update its MaterialSet"
            );
        }
        assert!(up > 0.6 && across.iter().all(|across| across.abs() < 0.02), "{name}: {up}, {across:?}");
        assert!(open_sky > 0.5 && open_sky < 0.999, "{name}: {open_sky}");
        assert!(low >= 0.0 && high <= 1.0 && high - low > 0.7, "{name}: {low} to {high}");
    }
}

#[test]
fn mips_keep_means_and_turn_normal_variance_into_roughness() {
    let Some(gpu) = open() else { return };
    let materials = bake(&gpu, &CustomMaterials::default());
    for (layer, name) in MATERIALS.iter().enumerate() {
        let layer = layer as u32;
        let first = colours(&gpu, &materials, layer, 0);
        for level in [1, 5, MATERIAL_SIZE.ilog2()] {
            let map = colours(&gpu, &materials, layer, level);
            for channel in 0..4 {
                let of = |map: &[[f32; 4]]| mean(map.iter().map(|texel| texel[channel]));
                let (expected, found) = (of(&first), of(&map));
                // Eleven bits, rounded once a level.
                assert!(
                    (found / expected - 1.0).abs() < 0.004,
                    "{name} {level} {channel}: {found}, {expected}"
                );
            }
        }
        let roughness =
            |level| mean(shapes(&gpu, &materials, layer, level).iter().map(|(_, rough, _)| *rough));
        let [near, far] = [0, 6].map(roughness);
        assert!(far > near, "{name}: {near} near, {far} far");
    }
}

/// A set of one grey; or with a slope in its height, so that it has something to lose.
fn grey(luminance: f32) -> CustomMaterials {
    let texel =
        BakeTexel { albedo: [luminance; 3], height: 0.5, normal: [0.0; 2], roughness: 0.5, occlusion: 1.0 };
    let own =
        CustomMaterial { texels: vec![texel; MATERIAL_TEXELS], normals_given: false, occlusion_given: false };
    CustomMaterials::new(std::array::from_fn(|_| Some(own.clone())))
}

#[test]
fn an_own_set_comes_out_as_it_went_in_and_flat_is_flat() {
    let Some(gpu) = open() else { return };
    let materials = bake(&gpu, &grey(0.25));
    for level in [0, 3, MATERIAL_SIZE.ilog2()] {
        assert!(colours(&gpu, &materials, 1, level).iter().all(|texel| *texel == [0.25, 0.25, 0.25, 0.5]));
        for (normal, roughness, occlusion) in shapes(&gpu, &materials, 1, level) {
            assert!(normal == [0.0, 0.0, 1.0] && occlusion == 1.0, "{normal:?} {occlusion}");
            assert!((roughness - 0.5).abs() < 0.01, "{roughness}");
        }
    }
}

#[test]
fn hexagons_keep_a_constant_and_remove_the_repetition() {
    let Some(gpu) = open() else { return };
    let seen = |materials: &Materials, look, anchor_m| {
        let probe = ProbeTiling::new(&gpu, materials);
        probe.run(&gpu, materials, 1, look, anchor_m).unwrap();
        probe.read(&gpu).unwrap()
    };
    let hex = Look::Textures(Tiling::Hex as u32);
    let constant = seen(&bake(&gpu, &grey(0.25)), hex, [0.0; 2]);
    assert!(constant.iter().all(|luminance| (luminance - 0.25).abs() < 1e-5));

    let materials = bake(&gpu, &CustomMaterials::default());
    let (width, tile) = (FIELD.0 as usize, MATERIAL_SIZE as usize);
    let repeats = |field: &[f32]| {
        let change = |step: usize| {
            mean(
                field
                    .chunks_exact(width)
                    .step_by(8)
                    .map(|row| mean(row.windows(step + 1).map(|w| (w[0] - w[step]).abs())))
                    .collect::<Vec<_>>()
                    .into_iter(),
            )
        };
        // Half a tile apart is as different as it gets.
        change(tile) / change(tile / 2 + 13)
    };
    let off = seen(&materials, Look::Textures(Tiling::Off as u32), [0.0; 2]);
    let hidden = seen(&materials, hex, [0.0; 2]);
    let reference = seen(&materials, Look::Recipe, [0.0; 2]);
    assert!(repeats(&off) < 0.01, "the control must repeat: {}", repeats(&off));
    for (name, field) in [("hexagons", &hidden), ("the recipe", &reference)] {
        assert!(repeats(field) > 0.9, "{name}: {}", repeats(field));
    }
    // A pattern period farther the hexagons are the same ones; a nearer anchor has others.
    let period = f32::from(8192u16);
    assert!(
        hidden == seen(&materials, hex, [period, period]) && hidden == seen(&materials, hex, [0.0, -period])
    );
    assert!(hidden != seen(&materials, hex, [256.0, 0.0]));
}

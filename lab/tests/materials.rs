//! Baked materials, read back: that they tile, that their mips keep what they must, and that they can be told from what does not.

use client::render::materials::{MATERIAL_SIZE, MATERIAL_TEXELS, Materials, OwnMaterial, OwnMaterials};
use client::render::{Gpu, gpu};
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

fn bake(gpu: &Gpu, own: &OwnMaterials) -> Materials {
    Materials::new(&gpu.device, &gpu.queue, own, true)
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
            layout: wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(stride), rows_per_image: None },
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
    let magnitude = if exponent == 0 { mantissa / 1024.0 * 2f32.powi(-14) } else { (1.0 + mantissa / 1024.0) * 2f32.powi(exponent - 15) };
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

/// Mean difference of neighbours across the seam over that inside, the larger of both directions: 1 for what tiles.
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
    let materials = bake(&gpu, &OwnMaterials::default());
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

#[test]
fn normals_point_up_heights_fill_their_range_and_colours_are_those_that_the_land_is_tinted_by() {
    let Some(gpu) = open() else { return };
    let materials = bake(&gpu, &OwnMaterials::default());
    for (layer, name) in MATERIALS.iter().enumerate() {
        let layer = layer as u32;
        let shapes = shapes(&gpu, &materials, layer, 0);
        let up = mean(shapes.iter().map(|(normal, ..)| normal[2]));
        let across = [0, 1].map(|axis| mean(shapes.iter().map(|(normal, ..)| normal[axis])));
        let open_sky = mean(shapes.iter().map(|(.., occlusion)| *occlusion));
        let map = heights(&gpu, &materials, layer);
        let (low, high) = map.iter().fold((1f32, 0f32), |(low, high), h| (low.min(*h), high.max(*h)));
        let last = colours(&gpu, &materials, layer, MATERIAL_SIZE.ilog2())[0];
        eprintln!("{name}: up {up:.3} across {across:?} sky {open_sky:.3} heights {low:.2}..{high:.2} mean {last:.4?}");
        assert!(up > 0.6 && across.iter().all(|across| across.abs() < 0.02), "{name}: {up}, {across:?}");
        assert!(open_sky > 0.5 && open_sky < 0.999, "{name}: {open_sky}");
        assert!(low >= 0.0 && high <= 1.0 && high - low > 0.7, "{name}: {low} to {high}");
    }
}

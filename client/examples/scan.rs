use terrain::Land;
fn main() {
    if std::env::args().nth(1).as_deref() == Some("bake") {
        use client::render::{Gpu, gpu, materials::{Materials, OwnMaterials}};
        let gpu = pollster::block_on(Gpu::open(gpu::instance(None), None)).unwrap();
        for _ in 0..2 {
            let t = std::time::Instant::now();
            let _m = Materials::new(&gpu.device, &gpu.queue, &OwnMaterials::default(), true);
            println!("recorded {:?}", t.elapsed());
            gpu.wait().unwrap();
            println!("baked {:?}", t.elapsed());
        }
        return;
    }
    let land = Land::new(1);
    let h = |x: f64, z: f64| land.height_at(terrain::Position::new((x * 256.0) as i32, (z * 256.0) as i32).unwrap()) as f64 / 256.0;
    let a: Vec<f64> = std::env::args().skip(1).map(|v| v.parse().unwrap()).collect();
    if a.len() >= 2 { println!("{}", h(a[0], a[1])); return; }
    let mut n = [0; 4];
    for i in 0..400i64 { for j in 0..400i64 {
        let (x, z) = (-5000.0 + 25.0 * ((i * 163) % 400) as f64, -5000.0 + 25.0 * ((j * 89) % 400) as f64);
        let y = h(x, z); let s = ((h(x+8.,z)-h(x-8.,z)).hypot(h(x,z+8.)-h(x,z-8.)))/16.;
        let k = if y > 0.8 && y < 1.8 && s < 0.1 {0} else if y > 10. && y < 60. && s < 0.1 {1} else if s > 0.85 && y > 5. {2} else if y > 240. {3} else {continue};
        if n[k] < 6 { n[k] += 1; println!("{} {x} {z} h={y:.1} s={s:.2}", ["beach","meadow","rock","summit"][k]); }
    }}
}

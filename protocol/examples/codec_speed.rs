use protocol::chunk_codec::*;
use protocol::*;
use std::hint::black_box;
use std::time::Instant;
use terrain::{constants::*, *};
fn main() {
    let land = Land::new(1);
    let w = land.digest();
    for level in [0u8, 1, 2, 4] {
        let mut cs = vec![];
        for z in -24i32..24 {
            for x in -24i32..24 {
                if (x * 7 + z * 13).rem_euclid(19) == 0 {
                    if let Ok(k) = ChunkKey::new(level, x >> level, z >> level) {
                        let (x0, z0) = k.origin();
                        if !land.archipelago().is_open_sea(x0, z0, k.side())
                            && !cs.iter().any(|c: &Chunk| c.key == k)
                        {
                            cs.push(land.chunk(k));
                        }
                    }
                }
            }
        }
        for (n, d, e) in [
            ("fast", Delivery::Exact, Effort::Fast),
            ("compact", Delivery::Exact, Effort::Compact),
            ("q16 fast", Delivery::Quantised(Tolerance::new(16).unwrap()), Effort::Fast),
            ("q16", Delivery::Quantised(Tolerance::new(16).unwrap()), Effort::Compact),
        ] {
            let fs: Vec<_> = cs.iter().map(|c| encode_with(d, e, c, &w)).collect();
            let b: usize = fs.iter().map(|f| f.len() - 65).sum();
            let mut te = vec![1e9f64; cs.len()];
            let mut th = te.clone();
            let mut td = te.clone();
            let mut h = Box::new([0; VERTEX_COUNT]);
            for _ in 0..25 {
                for i in 0..cs.len() {
                    let t = Instant::now();
                    black_box(encode_with(d, e, &cs[i], &w));
                    te[i] = te[i].min(t.elapsed().as_secs_f64() * 1e6);
                    let t = Instant::now();
                    heights_on(Kernel::best(), &fs[i], &mut h).unwrap();
                    black_box(&h);
                    th[i] = th[i].min(t.elapsed().as_secs_f64() * 1e6);
                    if d == Delivery::Exact {
                        let t = Instant::now();
                        black_box(decode(&fs[i], &w).unwrap());
                        td[i] = td[i].min(t.elapsed().as_secs_f64() * 1e6);
                    }
                }
            }
            let m = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
            println!(
                "level {level} {n:9} {:.4} B/v  enc {:.2} us  heights {:.2} us = {:.2} GB/s  whole {:.2} us",
                b as f64 / (cs.len() * VERTEX_COUNT) as f64,
                m(&te),
                m(&th),
                8450e-3 / m(&th),
                m(&td)
            );
        }
    }
}

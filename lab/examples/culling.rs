//! A first look at how culling does.
use client::plants::kept::{BySlot, blocks_of, clumps_of};
use client::plants::{Cull, PlantKnobs};
use client::world::select;
use lab::culling::oracle::{Oracle, eye_of};
use lab::culling::poses;
use lab::scenery::Scenery;
use shaders::twin::planting::{extent_of, may_be_in_view, block_extent};
use shaders::twin::sight::is_hidden;
use shaders::twin::surface::Surface;
use terrain::Land;

fn main() {
    let count: u32 = std::env::args().nth(1).map_or(6, |text| text.parse().unwrap());
    let every: usize = std::env::args().nth(2).map_or(50, |text| text.parse().unwrap());
    let mut scenery = Scenery::new(Land::new(1));
    let land = Land::new(1);
    let knobs = PlantKnobs { cull: Cull::Exact, ..PlantKnobs::STANDARD };
    let (mut false_culls, mut culled, mut kept_hidden, mut hidden, mut worst_root) = (0, 0, [0; 2], [0; 2], 0f64);
    let (mut bhid, mut bkept, mut bfalse)=(0,0,0);
    for trial in poses::seeded(&land, count, knobs) {
        let viewer = trial.shot.viewer();
        let mut world = scenery.world(&viewer, 5000, |_| true);
        let selection = select(&mut world, &viewer);
        let plants = trial.shot.plants(&world, &selection.drawn).unwrap();
        let oracle = Oracle::new(&world, &selection.drawn);
        let slots = BySlot::new(&world);
        let square = &plants.square;
        let surface = Surface { slots: &slots, tiles: &square.tiles, leaves: &square.leaves };
        let eye = eye_of(&trial.shot.pose);
        let metres = |x: i32, corner: i32| f64::from(x) / 4096.0 + f64::from(corner) / 256.0;
        for (kind, stand) in plants.stands.iter().enumerate() {
            let mut n = 0usize;
            let (mut all, mut tested, mut h, mut kh, mut c) = (0, 0, 0, 0, 0);
            let begun = std::time::Instant::now();
            for block in blocks_of(stand) {
              for clump in clumps_of(&surface, stand, block) {
                all += 1;
                n += 1;
                if n % (if kind == 0 { every } else { every / 10 + 1 }) != 0 { continue; }
                let extent = extent_of(&stand.culling, &stand.planting, &clump);
                if !may_be_in_view(&stand.culling, &extent) { continue; }
                tested += 1;
                let root = oracle_height(&oracle, metres(clump.x, square.corner[0]), metres(clump.z, square.corner[1]));
                worst_root = worst_root.max((root - f64::from(clump.y) / 4096.0).abs());
                let gone = is_hidden(&surface, stand.culling.eye, &extent.target, stand.culling.start);
                let at = |dx: f64, dz: f64, top: f64| [metres(clump.x, square.corner[0]) + dx, top, metres(clump.z, square.corner[1]) + dz];
                let (r, top) = (f64::from(extent.target.radius) / 4096.0, f64::from(extent.target.top) / 4096.0);
                let rim = (0..8).map(|n| { let a = f64::from(n) * std::f64::consts::FRAC_PI_4; (r * a.cos(), r * a.sin()) }).chain([(0.0, 0.0)]);
                let seen = rim.map(|(dx, dz)| at(dx, dz, top)).any(|p| oracle.sees(eye, p));
                if gone { c += 1; culled += 1; if seen { false_culls += 1; println!("FALSE {clump:?} {extent:?} {}", trial.name); } }
                if !seen { hidden[kind] += 1; h += 1; if !gone { kept_hidden[kind] += 1; kh += 1; } }
              }
            }
            println!("{}: kind {kind}: {all} clumps, {tested} tested, hidden {h}, kept {kh}, culled {c}; {:?}", trial.name, begun.elapsed());
            for (i, block) in blocks_of(stand).enumerate() { if i % 20 != 0 { continue; }
                let Some(e) = block_extent(&surface, &stand.planting, block[0], block[1]) else { continue };
                if !may_be_in_view(&stand.culling, &e) { continue; }
                let gone = is_hidden(&surface, stand.culling.eye, &e.target, stand.culling.start);
                let clumps: Vec<_> = clumps_of(&surface, stand, block).collect();
                if clumps.is_empty() { continue; }
                let any = clumps.iter().any(|cl| { let x = extent_of(&stand.culling, &stand.planting, cl);
                    oracle.sees(eye, [metres(cl.x, square.corner[0]), f64::from(x.target.top)/4096.0, metres(cl.z, square.corner[1])]) });
                if gone && any { bfalse += 1; }
                if !any { bhid += 1; if !gone { bkept += 1; } }
            }
            
        }
    }
    println!("false {false_culls} of {culled}; hidden kept {kept_hidden:?} of {hidden:?}; root off by {:.3} mm; blocks: hidden {bhid} kept {bkept} false {bfalse}", worst_root * 1e3);
}

fn oracle_height(oracle: &Oracle, x: f64, z: f64) -> f64 { oracle.height(x, z).unwrap_or(f64::NAN) }

//! x
use lab::{lod::screen, scenery::Scenery};
use terrain::Land;
fn main() {
    let land = Land::new(1);
    let arg = |n: usize, d: u32| std::env::args().nth(n).map_or(d, |n| n.parse().unwrap());
    let mut top: Vec<(f64, String)> = vec![];
    for (index, mut place) in screen::places(&land, arg(1, 8), arg(2, 31)).into_iter().enumerate() {
        let mut scenery = Scenery::new(land);
        if index % 4 == 3 { place.tolerance_px = 0.75; }
        let shot = place.shot();
        let (world, selection) = screen::selected(&mut scenery, &shot);
        let tau = place.tolerance_px;
        let seen = screen::measure(&land, &world, &selection, &shot);
        top.push((seen.max_px()/tau, format!("{index} tau {tau} chunks {} verts {}M ratio {:.3} zones {:.3?} rms {:.4} {:.3?} {}", selection.drawn.len(), seen.vertices/1000000, seen.max_px()/tau, seen.worst_px.map(|p| p/tau), seen.rms_px(), seen.worst, place.pose)));
    }
    top.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (_, text) in top.iter().take(12) { println!("{text}"); }
}

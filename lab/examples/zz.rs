//! x
fn main() {
    for v in lab::lod::triangles::count(&terrain::Land::new(1)) {
        println!("{} {} {} {}", v.camera, v.chunks, v.triangles, v.triangles_without_lod);
    }
}

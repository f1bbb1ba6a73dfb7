//! The tables of docs/heightfield.md against the code.

#[path = "../examples/test_vectors.rs"]
mod printed;

#[test]
fn the_published_tables_equal_the_code() {
    let page = include_str!("../../docs/heightfield.md");
    let tables = printed::tables();
    for line in tables.lines() {
        assert!(page.lines().any(|published| published == line), "not on the page: {line}");
    }
    assert!(tables.lines().count() > 40 && page.contains(tables.trim_end()), "in this order and whole");
}

#[test]
fn the_published_constants_equal_the_code() {
    use terrain::constants::{GRADIENTS, OCTAVE_SHIFT};
    let page = include_str!("../../docs/heightfield.md");
    let metres: Vec<String> = OCTAVE_SHIFT.iter().map(|(x, z)| format!("({}, {})", x >> 8, z >> 8)).collect();
    assert!(page.contains(&metres.join(" ")), "shifts: {}", metres.join(" "));
    for (index, (x, z)) in GRADIENTS.into_iter().enumerate() {
        let angle = (index as f64 + 0.5) * std::f64::consts::TAU / 32.0;
        let rounded = |v: f64| (v * 32_768.0).round() as i16;
        assert_eq!((x, z), (rounded(angle.cos()), rounded(angle.sin())), "the rule of the page");
    }
}

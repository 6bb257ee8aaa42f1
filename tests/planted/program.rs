// A third point-to-point ICP, a program that answers lines, with one planted mistake: rustc --cfg 'fault="n"'.
//
// Written from the equations and from PROTOCOL.md, with a table of cells over the target. It needs no crate.
use std::collections::HashMap;
use std::io::{self, BufRead, Write};
use std::time::Instant;

macro_rules! fault {
    ($number:literal) => {
        cfg!(fault = $number)
    };
}

const HELLO: &str = concat!(
    r#"{"protocol":1,"kind":"registration","summary":"point-to-point ICP over cells, a program","parameters":["#,
    r#"{"name":"epsilon","default":0.0001,"unit":"m","meaning":"stop when the error changes by less"},"#,
    r#"{"name":"max_iterations","default":40,"unit":"","meaning":"largest number of iterations"},"#,
    r#"{"name":"one_to_one","default":true,"unit":"","meaning":"of several sources with one target keep the closest"},"#,
    r#"{"name":"max_correspondence_m","default":0.3,"unit":"m","meaning":"largest distance of a pair, 0 for no limit"},"#,
    r#"{"name":"min_pairs","default":3,"unit":"","meaning":"fewest pairs"},"#,
    r#"{"name":"trace","default":false,"unit":"","meaning":"report every iteration"}]}"#
);

type Point = (f64, f64);

#[derive(Clone, Copy, Default)]
struct Pose {
    x: f64,
    y: f64,
    theta: f64,
}

impl Pose {
    fn apply(self, p: Point) -> Point {
        let (s, c) = self.theta.sin_cos();
        (c * p.0 - s * p.1 + self.x, s * p.0 + c * p.1 + self.y)
    }

    fn after(self, first: Pose) -> Pose {
        let (x, y) = self.apply((first.x, first.y));
        Pose { x, y, theta: self.theta + first.theta }
    }
}

#[derive(Default)]
struct Settings {
    epsilon: f64,
    limit: f64,
    max_iterations: usize,
    min_pairs: usize,
    one_to_one: bool,
    trace: bool,
}

struct Cells<'a> {
    points: &'a [Point],
    size: f64,
    of: HashMap<(i64, i64), Vec<usize>>,
}

fn whole(value: f64) -> i64 {
    if fault!("306") { value as i64 } else { value.floor() as i64 }
}

impl<'a> Cells<'a> {
    fn new(points: &'a [Point], limit: f64) -> Self {
        let size = if limit > 0.0 { limit } else { f64::INFINITY };
        let mut of: HashMap<(i64, i64), Vec<usize>> = HashMap::new();
        for (j, p) in points.iter().enumerate() {
            of.entry(Self::cell(*p, size)).or_default().push(j);
        }
        Cells { points, size, of }
    }

    fn cell(p: Point, size: f64) -> (i64, i64) {
        if size.is_infinite() { (0, 0) } else { (whole(p.0 / size), whole(p.1 / size)) }
    }

    // The nearest point nearer than the limit, the first of equally near ones.
    fn nearest(&self, at: Point) -> Option<(usize, f64)> {
        let (column, row) = Self::cell(at, self.size);
        let mut best: Option<(usize, f64)> = None;
        for c in column - 1..=column + 1 {
            for r in row - 1..=row + 1 {
                for &j in self.of.get(&(c, r)).map_or(&[][..], |cell| &cell[..]) {
                    let (dx, dy) = (self.points[j].0 - at.0, self.points[j].1 - at.1);
                    let d = dx * dx + dy * dy;
                    if best.map_or(true, |(k, least)| d < least || (d == least && j < k)) {
                        best = Some((j, d));
                    }
                }
            }
        }
        best.filter(|&(_, d)| d < self.size * self.size).map(|(j, d)| (j, d.sqrt()))
    }
}

fn associate(settings: &Settings, cells: &Cells, moved: &[Point]) -> Vec<(usize, usize)> {
    let found: Vec<_> = moved.iter().map(|p| cells.nearest(*p)).collect();
    let mut pairs: Vec<(usize, usize)> = Vec::new();
    if !settings.one_to_one {
        pairs.extend(found.iter().enumerate().filter_map(|(i, one)| one.map(|(j, _)| (i, j))));
        return pairs;
    }
    let mut owner: HashMap<usize, (usize, f64)> = HashMap::new();
    for (i, one) in found.iter().enumerate() {
        if let Some((j, d)) = *one {
            let held = owner.entry(j).or_insert((i, d));
            if d < held.1 {
                *held = (i, d);
            }
        }
    }
    pairs.extend(owner.iter().map(|(j, (i, _))| (*i, *j)));
    if !fault!("304") {
        pairs.sort_unstable();
    }
    pairs
}

fn best_motion(pairs: &[(usize, usize)], target: &[Point], moved: &[Point]) -> Pose {
    let n = pairs.len() as f64;
    let (mut px, mut py, mut qx, mut qy) = (0.0, 0.0, 0.0, 0.0);
    for &(i, j) in pairs {
        px += moved[i].0 / n;
        py += moved[i].1 / n;
        qx += target[j].0 / n;
        qy += target[j].1 / n;
    }
    let (mut dot, mut cross) = (0.0, 0.0);
    for &(i, j) in pairs {
        let (ax, ay, bx, by) = (moved[i].0 - px, moved[i].1 - py, target[j].0 - qx, target[j].1 - qy);
        dot += ax * bx + ay * by;
        cross += ax * by - ay * bx;
    }
    let turn = Pose { x: 0.0, y: 0.0, theta: f64::atan2(cross, dot) };
    let (rx, ry) = turn.apply((px, py));
    Pose { x: qx - rx, y: qy - ry, theta: turn.theta }
}

fn number(value: f64) -> String {
    if !value.is_finite() {
        "null".to_string()
    } else if fault!("301") {
        format!("{value:.6}")
    } else {
        format!("{value:?}")
    }
}

fn shown(pose: Pose) -> String {
    if fault!("313") {
        return format!("[{},{},{}]", number(pose.theta), number(pose.x), number(pose.y));
    }
    format!("[{},{},{}]", number(pose.x), number(pose.y), number(pose.theta))
}

fn register(settings: &Settings, target: &[Point], source: &[Point], guess: Pose) -> String {
    let begun = Instant::now();
    let mut pose = guess;
    let mut moved: Vec<Point> = source.iter().map(|p| pose.apply(*p)).collect();
    let (mut previous, mut error, mut iterations, mut inliers, mut converged) = (f64::INFINITY, f64::NAN, 0, 0, false);
    let mut trace: Vec<String> = Vec::new();
    if fault!("308") && target[0].0 > 1e300 {
        return String::new();
    }
    let cells = Cells::new(target, settings.limit);
    while !target.is_empty() && !source.is_empty() && iterations < settings.max_iterations && !converged {
        let pairs = associate(settings, &cells, &moved);
        inliers = pairs.len();
        if inliers < settings.min_pairs {
            pose = guess;
            error = f64::NAN;
            break;
        }
        pose = best_motion(&pairs, target, &moved).after(pose);
        moved = source.iter().map(|p| pose.apply(*p)).collect();
        let sum: f64 = pairs.iter().map(|&(i, j)| (target[j].0 - moved[i].0).hypot(target[j].1 - moved[i].1)).sum();
        error = sum / inliers as f64;
        let change = if fault!("307") { previous - error } else { (error - previous).abs() };
        converged = change < settings.epsilon;
        previous = error;
        iterations += 1;
        if settings.trace {
            let flat: Vec<String> = pairs.iter().map(|(i, j)| format!("{i},{j}")).collect();
            let pairs = if fault!("pairs") { format!(r#","pairs":[{}]"#, flat.join(",")) } else { String::new() };
            trace.push(format!(r#"{{"pose":{},"error_m":{},"inliers":{inliers}{pairs}}}"#, shown(pose), number(error)));
        }
    }
    let inliers = if fault!("305") { inliers as u8 as usize } else { inliers };
    let error = if fault!("316") && !converged { f64::NAN } else { error };
    let trace = if settings.trace { format!(r#","trace":[{}]"#, trace.join(",")) } else { String::new() };
    format!(
        r#"{{"pose":{},"converged":{converged},"iterations":{iterations},"error_m":{},"inliers":{inliers},"elapsed_ns":{}{trace}}}"#,
        shown(pose), number(error), begun.elapsed().as_nanos()
    )
}

fn text_after<'a>(line: &'a str, key: &str, end: char) -> &'a str {
    let start = line.find(&format!("\"{key}\":")).map_or(line.len(), |at| at + key.len() + 3);
    let rest = line[start..].trim_start_matches('[');
    &rest[..rest.find(end).unwrap_or(rest.len())]
}

fn value(line: &str, key: &str) -> String {
    text_after(line, key, '}').split(',').next().unwrap_or("").to_string()
}

fn numbers(line: &str, key: &str) -> Vec<f64> {
    let parse = |text: &str| {
        let digits = if fault!("319") { text.split('e').next().unwrap_or("") } else { text };
        digits.parse().ok()
    };
    text_after(line, key, ']').split(',').filter_map(parse).collect()
}

fn points(line: &str, key: &str) -> Vec<Point> {
    numbers(line, key).chunks_exact(2).map(|p| (p[0], p[1])).collect()
}

fn main() {
    let mut out = io::BufWriter::with_capacity(1 << 22, io::stdout());
    let mut settings = Settings::default();
    let mut kept: Vec<Point> = Vec::new();
    let mut calls = 0;
    for line in io::stdin().lock().lines() {
        let mut line = line.expect("a line");
        if fault!("303") && line.len() > 65_536 {
            line.truncate(65_536);
        }
        let answer = match value(&line, "ask").as_str() {
            "\"hello\"" => HELLO.to_string(),
            "\"create\"" => {
                settings = Settings {
                    epsilon: value(&line, "epsilon").parse().unwrap_or(1e-4),
                    limit: value(&line, "max_correspondence_m").parse().unwrap_or(0.3),
                    max_iterations: value(&line, "max_iterations").parse().unwrap_or(40),
                    min_pairs: value(&line, "min_pairs").parse().unwrap_or(3),
                    one_to_one: value(&line, "one_to_one") == "true",
                    trace: value(&line, "trace") == "true",
                };
                "{}".to_string()
            }
            "\"register\"" => {
                let guess = numbers(&line, "guess");
                let guess = if fault!("312") {
                    Pose { x: guess[1], y: guess[2], theta: guess[0] }
                } else {
                    Pose { x: guess[0], y: guess[1], theta: guess[2] }
                };
                let target = points(&line, "target");
                if !(fault!("311") && kept.len() == target.len()) {
                    kept = target;
                }
                if fault!("309") {
                    calls += 1;
                    if calls % 50 == 0 {
                        std::thread::spawn(|| std::thread::sleep(std::time::Duration::from_secs(3600)));
                    }
                }
                if fault!("310") {
                    std::hint::black_box(Box::leak(vec![1u8; 4096].into_boxed_slice()));
                }
                if fault!("318") {
                    writeln!(out, "registering {} points", kept.len()).expect("a reader");
                }
                register(&settings, &kept, &points(&line, "source"), guess)
            }
            _ => r#"{"failed":"unknown question"}"#.to_string(),
        };
        writeln!(out, "{answer}").expect("a reader");
        if !fault!("302") {
            out.flush().expect("a reader");
        }
    }
}

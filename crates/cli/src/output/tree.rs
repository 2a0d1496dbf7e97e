//! Named values in order, as aligned text for people or as JSON for programs.

use luxel_app::schema::{Document, VERSION_FIELD};
use luxel_app::text;
use serde_json::{Map, Value};

/// An ordered tree of named values. Names are those of the JSON; text shows them with spaces for
/// underscores. A name that ends in `_bytes` is printed as a file size.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tree {
    entries: Vec<(String, Fact)>,
}

#[derive(Clone, Debug)]
enum Fact {
    Value(Value),
    Group(Tree),
}

impl Tree {
    /// Adds a value.
    pub(crate) fn set(&mut self, name: &str, value: impl Into<Value>) -> &mut Self {
        self.entries.push((name.to_owned(), Fact::Value(value.into())));
        self
    }

    /// Adds a single-precision number with the digits it has, not those of its double.
    pub(crate) fn set_f32(&mut self, name: &str, value: f32) -> &mut Self {
        self.set(name, single(value))
    }

    /// Adds a list of single-precision numbers.
    pub(crate) fn set_f32s(&mut self, name: &str, values: &[f32]) -> &mut Self {
        self.set(name, values.iter().copied().map(single).collect::<Vec<Value>>())
    }

    /// Adds a group.
    pub(crate) fn group(&mut self, name: &str, facts: Tree) -> &mut Self {
        self.entries.push((name.to_owned(), Fact::Group(facts)));
        self
    }

    /// Returns the tree as JSON.
    pub(crate) fn json(&self) -> Value {
        let entries = self.entries.iter().map(|(name, fact)| {
            let value = match fact {
                Fact::Value(value) => value.clone(),
                Fact::Group(facts) => facts.json(),
            };
            (name.clone(), value)
        });
        Value::Object(entries.collect::<Map<_, _>>())
    }

    /// Returns the tree as the text of a document.
    pub(crate) fn document(&self, document: Document) -> String {
        let Value::Object(mut entries) = self.json() else { return String::new() };
        entries.insert(VERSION_FIELD.to_owned(), document.version.into());
        format!("{:#}", Value::Object(entries))
    }

    /// Returns the tree as an event for programs.
    pub(crate) fn event(&self, name: &str) -> Value {
        let mut event = Map::from_iter([("event".to_owned(), name.into())]);
        if let Value::Object(entries) = self.json() {
            event.extend(entries);
        }
        Value::Object(event)
    }

    /// Returns the tree as aligned lines.
    pub(crate) fn text(&self) -> String {
        let mut out = String::new();
        self.write_text(&mut out, 0);
        out
    }

    fn write_text(&self, out: &mut String, indent: usize) {
        let width = self.entries.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        for (name, fact) in &self.entries {
            let label = name.strip_suffix("_bytes").unwrap_or(name).replace('_', " ");
            match fact {
                Fact::Value(Value::Null) => {}
                Fact::Value(Value::Array(items)) if items.iter().any(Value::is_string) => {
                    *out += &format!("{:indent$}{label}\n", "");
                    for item in items {
                        let text = fitting(value_text(name, item), indent + 4, indent + 4);
                        *out += &format!("{:indent$}  - {text}\n", "");
                    }
                }
                Fact::Value(value) => {
                    let text = fitting(value_text(name, value), indent + width + 2, indent + 2);
                    let line = format!("{:indent$}{label:width$}  {text}", "");
                    // A value may begin on a line of its own.
                    *out += &line.lines().map(|line| line.trim_end().to_owned() + "\n").collect::<String>();
                }
                Fact::Group(facts) => {
                    *out += &format!("{:indent$}{label}\n", "");
                    facts.write_text(out, indent + 2);
                }
            }
        }
    }
}

/// Columns of the terminal that a line may take.
const COLUMNS: usize = 80;

/// Returns a value that begins at column `at`, in lines that fit into the terminal: with less space
/// between its parts, on a line of its own from column `below` on, or on several lines. What has no
/// space to break at stays whole.
fn fitting(text: String, at: usize, below: usize) -> String {
    let fits = |text: &str, at: usize| at + text.chars().count() <= COLUMNS;
    if fits(&text, at) || text.is_empty() {
        return text;
    }
    let words: Vec<&str> = text.split_whitespace().collect();
    let narrow = words.join(" ");
    if fits(&narrow, at) {
        return narrow;
    }
    if let [_] = words.as_slice() {
        return if fits(&narrow, below) { format!("\n{:below$}{narrow}", "") } else { text };
    }
    let (mut out, mut column) = (String::new(), at);
    for (i, word) in words.iter().enumerate() {
        let length = word.chars().count();
        if i > 0 && column + 1 + length > COLUMNS {
            out += &format!("\n{:at$}", "");
            column = at;
        } else if i > 0 {
            out.push(' ');
            column += 1;
        }
        out += word;
        column += length;
    }
    out
}

fn single(value: f32) -> Value {
    // The shortest decimal that is this f32: 0.1 and not 0.10000000149.
    value.to_string().parse::<f64>().ok().and_then(serde_json::Number::from_f64).map_or(Value::Null, Value::Number)
}

fn value_text(name: &str, value: &Value) -> String {
    match value {
        Value::String(text) => text::one_line(text).into_owned(),
        Value::Bool(true) => "yes".into(),
        Value::Bool(false) => "no".into(),
        Value::Number(number) => match (number.as_u64(), number.as_f64()) {
            (Some(n), _) if name.ends_with("_bytes") => text::bytes(n),
            (Some(n), _) => usize::try_from(n).map_or_else(|_| n.to_string(), text::count),
            (None, Some(v)) => text::number(v),
            (None, None) => number.to_string(),
        },
        Value::Array(items) => items.iter().map(|item| value_text(name, item)).collect::<Vec<_>>().join("  "),
        Value::Null | Value::Object(_) => value.to_string(),
    }
}

/// Adds a point of the world, with the digits that the scene's positions have.
pub(crate) fn set_point(facts: &mut Tree, name: &str, point: [f64; 3], scene: &luxel_core::Scene) {
    if scene.world_from_local.translation() == glam::DVec3::ZERO {
        facts.set_f32s(name, &point.map(|v| v as f32));
    } else {
        facts.set(name, point.to_vec());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts() -> Tree {
        let mut bounds = Tree::default();
        bounds.set_f32s("min", &[-1.0, 0.1, 2.5]);
        let mut facts = Tree::default();
        facts.set("kind", "scene").set("file_bytes", 2048).set("splats", 45210).set_f32("scale", 0.1).group("bounds", bounds);
        facts.set("warnings", vec!["odd"]);
        facts
    }

    #[test]
    fn text_is_aligned_and_has_units() {
        assert_eq!(
            facts().text(),
            "kind        scene\nfile        2.0 KiB\nsplats      45,210\nscale       0.1000\nbounds\n  min  -1.000  0.1000  2.500\nwarnings\n  - odd\n"
        );
    }

    #[test]
    fn lines_fit_into_a_terminal() {
        let mut facts = Tree::default();
        let sentence = "a long sentence about the scene that goes on and on until it is wider than the terminal that shows it";
        facts.set("note", sentence).set("fingerprint", "0123456789abcdef".repeat(4) + "0123456");
        facts.set_f32s("scale", &[0.001_327, 0.003_082, 0.007_769, 0.011_08, 0.015_82, 0.051_73, 0.361_06, 1.012_3]);
        let text = facts.text();
        assert!(text.lines().all(|line| line.chars().count() <= COLUMNS && line == line.trim_end()), "{text}");
        let words = |text: &str| text.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        assert!(words(&text).join(" ").contains(sentence), "{text}");
        assert!(text.contains("\nfingerprint\n  0123"), "{text}");
        // A path that fits nowhere stays in one piece.
        facts = Tree::default();
        facts.set("file", "x".repeat(100));
        assert_eq!(facts.text(), format!("file  {}\n", "x".repeat(100)));
    }

    #[test]
    fn json_has_the_same_names_and_the_digits_of_single_precision() {
        assert_eq!(
            facts().json().to_string(),
            r#"{"bounds":{"min":[-1.0,0.1,2.5]},"file_bytes":2048,"kind":"scene","scale":0.1,"splats":45210,"warnings":["odd"]}"#
        );
    }
}

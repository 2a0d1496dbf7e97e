//! Text into HTML, and the frame that all pages share.

/// Returns text that is safe in element content and in quoted attributes. Control characters that
/// HTML forbids are dropped.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#39;",
            '\n' | '\t' => out.push(c),
            c if c.is_control() => {}
            c => out.push(c),
        }
    }
    out
}

/// Returns a self-contained page: `title` and `subtitle` are text, `body` is HTML.
pub fn document(title: &str, subtitle: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\"><meta name=\"generator\" content=\"Luxel {}\">\
         <title>{title} · Luxel</title><style>{}</style></head><body><main><header><h1>{title}</h1><p class=\"soft\">{}</p></header>\n\
         {body}</main></body></html>\n",
        env!("CARGO_PKG_VERSION"),
        include_str!("style.css"),
        escape(subtitle),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_becomes_text() {
        assert_eq!(escape("<a href=\"x\" b='y'>&\0\n"), "&lt;a href=&quot;x&quot; b=&#39;y&#39;&gt;&amp;\n");
    }
}

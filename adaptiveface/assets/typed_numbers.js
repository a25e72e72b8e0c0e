// The numbers beside sliders, clicked and typed over. ipywidgets lets them be edited and then forgets what was typed.
// Enter or a click elsewhere sends the text; the kernel answers by moving the slider, which writes the number anew.

const NUMBER = "adaptiveface-number-";

function render({ model, el }) {
  let before = "";

  // The slider whose number is being edited, if it stands in the same box as this widget.
  function sliderOf(number) {
    if (!number.matches?.(".widget-readout")) return null;
    const slider = number.closest(`[class*="${NUMBER}"]`);
    return slider && el.closest(".adaptiveface-numbers")?.contains(slider) ? slider : null;
  }
  function begin({ target }) {
    if (sliderOf(target)) before = target.textContent;
  }
  function end({ target }) {
    const slider = sliderOf(target);
    const text = target.textContent;
    if (!slider || text === before) return;
    target.textContent = before;
    const name = [...slider.classList].find((part) => part.startsWith(NUMBER));
    model.send({ slider: name.slice(NUMBER.length), text: text.trim() });
  }
  function key(event) {
    if (event.key !== "Enter" || !sliderOf(event.target)) return;
    event.preventDefault();
    event.target.blur();
  }

  const listeners = { focusin: begin, focusout: end, keydown: key };
  for (const [name, listener] of Object.entries(listeners)) document.addEventListener(name, listener, true);
  return () => {
    for (const [name, listener] of Object.entries(listeners)) document.removeEventListener(name, listener, true);
  };
}

export default { render };

"""The one compiled kernel: single cars, batches and long records all run through `steps.march`.

A step of length h is exact in the linear part (matrix exponential, inputs linear over the step, currents held).
Dry friction is set-valued and projected (Moreau, time stepping at velocity level: Acary and Brogliato, Springer
2008): its force is the one within its bound that stops the sliding, or the bound. Smooth laws enter as a force that
is linear over the step with its end value found implicitly (second order).

Cars are *lanes*, eight to a group. There are three ways through a step: in closed form and without branches (at most one
constant friction and one stop: the car), law by law in those lanes that touch something, or law by law in all lanes. Which of
them is a property of the network, and no lane sees its neighbours, so a car in a batch is the same car alone, to the last bit.

Several laws that see one another are solved by Gauss-Seidel sweeps of secant steps, and where these do not settle by a
safeguarded Newton iteration. A step that is not solved to `newton.GOOD` is no result: its number and law are written down, and
the lane's state becomes nan.

To be read in this order:

- `layout`: where each number lies, by name; `lanes`: arithmetic on eight numbers at once;
- `linear`: the linear part of a step; `contact`: its end in closed form; `laws`, `newton`, `solve`: its end law by law;
- `steps`: steps, records, outputs; `cars`: a control step of many cars with drive, road, limits, reward and observation;
- `compiled`: all of that compiled, with the laws that are registered.

The functions are plain Python until `compiled.kernel` binds them: they name one another and are compiled together.
Importing this package costs nothing; `layout` and what stands on it does not need the compiler.
"""
